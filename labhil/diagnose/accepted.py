"""An accepted model from a file: its values, their covariance, and how well it fitted.

``verify.py`` tests a recording against it; ``diagnosis.py`` compares refitted values with it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from labhil.errors import ModelFileError
from labhil.identify.fitted import free_parameter_indices, start_theta
from labhil.identify.statistics import Estimate
from labhil.physics.model import Model
from labhil.physics.terms import Parameter, keyed
from labhil.signals import FloatArray, IntArray


@dataclass(frozen=True, slots=True)
class Accepted:
    """An accepted model.

    Attributes:
        name: name of the file.
        rig: name of the rig, if the file states it.
        terms: keys of its terms.
        values: values by parameter key, SI units.
        keys: parameter keys of the covariance.
        covariance: covariance of their values, (k, k), SI units; infinite variances for unknown values.
        residual_ratio: RMSE over noise floor on the data that the model was fitted to, by channel (with the
            joint, as ``keyed``).
        shortest: the same on the shortest windows that were fitted.
        window: length of the windows that the model was fitted on, s.
    """

    name: str
    rig: str | None
    terms: tuple[str, ...]
    values: Mapping[str, float]
    keys: tuple[str, ...] = ()
    covariance: FloatArray | None = None
    residual_ratio: Mapping[str, float] = field(default_factory=dict)
    shortest: float | None = None
    window: float | None = None

    def vector(self, model: Model) -> FloatArray:
        """Arrange the values as the parameter vector of a model.

        Args:
            model: the model.

        Returns:
            All parameters of the model, (P,).

        Raises:
            ModelFileError: if the file lacks a parameter that the model needs, or has one that the model does
                not have.
        """
        model_keys = {p.key for p in model.parameters}
        for key in self.values:
            if key not in model_keys and key not in model.fixed:
                raise ModelFileError(
                    f"{self.name}: parameters: expected parameters of {model.kind}, found {key!r}"
                )
        for i in free_parameter_indices(model, self.terms):
            key = model.parameters[i].key
            if key not in self.values:
                raise ModelFileError(
                    f"{self.name}: parameters: expected a value of {key!r}, which the model needs "
                    "(or state it in [known] of the rig file), found none"
                )
        return start_theta(model, self.values)

    def covariance_of(self, wanted: Sequence[str]) -> FloatArray:
        """Covariance of some of the values.

        Args:
            wanted: keys of the parameters.

        Returns:
            Covariance, (k, k), SI units; zero for values that are taken as exact.
        """
        result = np.zeros((len(wanted), len(wanted)))
        if self.covariance is None:
            return result
        stored = {key: i for i, key in enumerate(self.keys)}
        rows = [i for i, key in enumerate(wanted) if key in stored]
        stored_rows: IntArray = np.array([stored[wanted[i]] for i in rows], dtype=np.int64)
        result[np.ix_(rows, rows)] = self.covariance[np.ix_(stored_rows, stored_rows)]
        return result

    def allowed_ratio(
        self, channel: str, refitted: float | None = None, *, max_coloured_ratio: float = 3.0
    ) -> float:
        """RMSE over noise floor that the accepted model reached and that noise alone explains.

        The floor is estimated from differences of neighbouring samples, which coloured noise exceeds in short
        windows as in long ones. An error that grows with the window, or is too large for coloured noise, was
        misfit and is not allowed.

        Args:
            channel: the output, with its joint as ``keyed``.
            refitted: ratio that a refit reaches where no floor is known, as of inverse dynamics, whose filter
                removes fast changes.
            max_coloured_ratio: ratio that coloured noise reaches at most, at a correlation of neighbouring
                samples of 0.85.

        Returns:
            The allowed ratio, at least 1.
        """
        if refitted is not None:
            return max(1.0, self.residual_ratio.get(channel, refitted))
        reached = min(self.residual_ratio.get(channel, 1.0), self.shortest or max_coloured_ratio)
        return min(max(1.0, reached), max_coloured_ratio)


def accepted_error(accepted: Accepted | None, of: Estimate | Parameter) -> float:
    """Standard error of a value of the accepted model.

    Args:
        accepted: the accepted model, if there is one.
        of: the parameter or an estimate of it.

    Returns:
        Standard error, SI units; 0 without an accepted model and for a value that is taken as exact.
    """
    if accepted is None:
        return 0.0
    # a model of one recording states one value for all recordings
    keys = (of.key, keyed(of.name, of.joint))
    key = next((key for key in keys if key in accepted.keys), of.key)
    return float(np.sqrt(accepted.covariance_of([key])[0, 0]))
