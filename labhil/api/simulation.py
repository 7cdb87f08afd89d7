"""``labhil.Simulation``: the model of a result, run on a recording."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from labhil.api.inputs import PathLike, names_of, number_or_none, recordings_of
from labhil.api.render import axes_of, data_frame, data_set
from labhil.errors import UnknownNameError, UsageError
from labhil.extras import require, require_analysis
from labhil.signals import FloatArray, IntArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from labhil.analysis.saved_model import SavedModel
    from labhil.analysis.schema import ChannelErrors
    from labhil.api.recording import Recording


@dataclass(frozen=True, slots=True, eq=False)
class Simulation:
    """Prediction of a recording by a model, with the measurement.

    The recording is split into windows of ``horizon`` s. Each is simulated from the state estimated from its
    lead-in, as models are scored; inverse dynamics has no state, and ``horizon`` is None.

    Attributes:
        t: Times of the samples, (n,) s.
        measured: Measured values by output, each (n,).
        simulated: Predicted values, likewise; NaN in the lead-ins, which are not scored.
        units: Units by output.
        errors: Errors by output: ``rmse``, ``max_abs_error``, ``r2`` (a fraction), ``noise_floor``.
        horizon: Length of the windows, s.
        window: Index of each sample's window, (n,); −1 in the lead-ins.
        name: Name of the recording.

    Example:
        >>> import labhil as lh
        >>> fit = lh.fit("recordings/ball_beam_identify.mcap", span=(0, 12), estimator="nlse",
        ...              terms=["viscous_friction", "coulomb_friction"])
        >>> run = fit.simulate("recordings/ball_beam_test.mcap")
        >>> run.simulated["ball_position"].shape == run.t.shape
        True
        >>> run.errors["ball_position"].rmse < 0.05
        True
    """

    t: FloatArray
    measured: Mapping[str, FloatArray]
    simulated: Mapping[str, FloatArray]
    units: Mapping[str, str]
    errors: Mapping[str, ChannelErrors]
    horizon: float | None
    window: IntArray
    name: str = ""

    def __repr__(self) -> str:
        method = "inverse dynamics" if self.horizon is None else f"windows of {self.horizon:.3g} s"
        figures = ", ".join(
            f"{name} RMSE {row.rmse or 0.0:.3g} {row.unit}, noise floor {row.noise_floor or 0.0:.3g}"
            for name, row in self.errors.items()
        )
        return f"<Simulation of {self.name}, {method}: {figures}>"

    def to_pandas(self) -> Any:
        """Return a pandas DataFrame over ``t`` (s), with columns ``NAME`` (measured) and ``NAME_simulated``.

        Raises:
            MissingExtraError: pandas is not installed.
        """
        columns = {**self.measured, **{f"{name}_simulated": x for name, x in self.simulated.items()}}
        return data_frame(columns, index=self.t, index_name="t")

    def to_xarray(self) -> Any:
        """Return measured and simulated values as an xarray Dataset over ``t`` (s).

        Raises:
            MissingExtraError: xarray is not installed.
        """
        columns = [(name, name, x) for name, x in self.measured.items()]
        columns += [(f"{name}_simulated", name, x) for name, x in self.simulated.items()]
        variables = {label: (("t",), x, {"units": self.units[name]}) for label, name, x in columns}
        return data_set(variables, {"t": self.t}, {"horizon": self.horizon})

    def plot(self, ax: Axes | None = None, *, name: str | None = None) -> Axes:
        """Draw measurement and simulation.

        Args:
            ax: Axes to draw into; by default new ones.
            name: The output; by default the first.

        Returns:
            The matplotlib axes.

        Raises:
            UnknownNameError: There is no such output.
        """
        require("matplotlib", "a plot")
        from labhil.report.figure import AFTER, MEASURED, finish

        output = next(iter(self.measured)) if name is None else name
        if output not in self.measured:
            raise UnknownNameError("output", output, self.measured)
        axes, row = axes_of(ax), self.errors[output]
        axes.plot(self.t, self.measured[output], color=MEASURED, lw=2.5, alpha=0.5, label="measured")
        label = "model" if row.rmse is None else f"model, RMSE {row.rmse:.3g} {row.unit}"
        axes.plot(self.t, self.simulated[output], color=AFTER, lw=1.0, label=label)
        finish(axes, "Model and measurement", "t, s", f"{output}, {self.units[output]}")
        return axes


def simulate(
    saved: SavedModel,
    rec: PathLike | Recording,
    *,
    rig: str | None,
    horizon: float | None,
    without: Iterable[str] | str = (),
) -> Simulation:
    """Run the model of a result on a recording of a rig of the same kind; see :class:`Simulation`."""
    require_analysis("a simulation")
    from labhil.analysis.simulate import simulate_recording

    switched_off = names_of(without, "without") or ()
    simulation = simulate_recording(
        recordings_of(rec, "recording")[0], saved, rig, number_or_none(horizon, "horizon"), switched_off
    )
    record, score = simulation.record, simulation.score
    names = record.output_names
    predicted = np.full(record.outputs.shape, np.nan)
    predicted[score.rows] = record.outputs[score.rows] + score.errors
    window = np.full(len(record.t), -1)
    window[score.rows] = score.window
    rows = simulation.part.scored
    if len(rows) != len(names):
        raise UsageError(f"{saved}: expected a score of each of {', '.join(names)}")
    return Simulation(
        t=record.t,
        measured=dict(zip(names, record.outputs.T, strict=True)),
        simulated=dict(zip(names, predicted.T, strict=True)),
        units=dict(zip(names, record.output_units, strict=True)),
        errors=dict(zip(names, rows, strict=True)),
        horizon=score.horizon,
        window=window,
        name=simulation.name,
    )
