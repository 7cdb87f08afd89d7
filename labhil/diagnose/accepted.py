"""A model that was accepted, as a file states it: values, their errors, and how well it fitted."""

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

MOST_COLOURED = 3.0
"""Ratio of RMSE to floor beyond which no coloured noise is believed: neighbours correlated by 0.85."""


@dataclass(frozen=True, slots=True)
class Accepted:
    """Values by parameter key, terms, and what else the file has.

    ``covariance`` (k, k) belongs to ``keys`` (SI units; infinite variances for what is not known);
    ``residual_ratio`` maps channels (with the joint, as ``keyed``) to RMSE over noise floor on the data
    that the model was fitted to, and ``shortest`` is the same of its shortest fitted windows; ``window`` is
    the length (s) of the windows that it was fitted on.
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
        """The model's whole vector (all parameters) at these values.

        ModelFileError names a rig's own parameter that the model needs and the file does not give, or one
        that the model does not have.
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
        """Covariance (k, k) of the parameters ``wanted``; zero for what is taken as exact."""
        result = np.zeros((len(wanted), len(wanted)))
        if self.covariance is None:
            return result
        stored = {key: i for i, key in enumerate(self.keys)}
        rows = [i for i, key in enumerate(wanted) if key in stored]
        stored_rows: IntArray = np.array([stored[wanted[i]] for i in rows], dtype=np.int64)
        result[np.ix_(rows, rows)] = self.covariance[np.ix_(stored_rows, stored_rows)]
        return result

    def allowed_ratio(self, channel: str, refitted: float | None = None) -> float:
        """RMSE over noise floor that the accepted model reached and that noise alone explains, ≥ 1.

        Coloured noise is larger than the floor that is read from the quickest changes, in short windows as in
        long ones; what grows with the window, or is too much for noise, was misfit, and none of that is
        allowed. ``refitted`` is the ratio that a refit reaches where no floor is known, as of inverse
        dynamics, whose filter takes the quickest changes out.
        """
        if refitted is not None:
            return max(1.0, self.residual_ratio.get(channel, refitted))
        reached = min(self.residual_ratio.get(channel, 1.0), self.shortest or MOST_COLOURED)
        return min(max(1.0, reached), MOST_COLOURED)


def accepted_error(accepted: Accepted | None, of: Estimate | Parameter) -> float:
    """Standard error of a value of the accepted model, zero where there is none or it is taken as exact."""
    if accepted is None:
        return 0.0
    # a model of one recording states a value once for all
    keys = (of.key, keyed(of.name, of.joint))
    key = next((key for key in keys if key in accepted.keys), of.key)
    return float(np.sqrt(accepted.covariance_of([key])[0, 0]))
