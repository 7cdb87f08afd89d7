"""The improvement by the final model of a diagnosis, in its JSON (`labhil.diagnosis/1`)."""

from __future__ import annotations

from labhil.analysis.schema.parts import ChannelErrors, Number, Part, RecordingErrors, Score

BEFORE_AND_AFTER = ("mse", "rmse", "max_abs_error", "r2", "relative_error")
"""Figures of a channel that are stated for baseline and final model."""


class ChannelImprovement(Part):
    """Errors of one channel under baseline and final model."""

    channel: str
    joint: int | None = None
    unit: str = ""
    rmse_before: Number
    rmse_after: Number
    noise_floor: Number = None
    noise_floor_before: Number = None
    r2_before: Number = None
    r2_after: Number = None
    mse_before: Number = None
    mse_after: Number = None
    max_abs_error_before: Number = None
    max_abs_error_after: Number = None
    relative_error_before: Number = None
    relative_error_after: Number = None
    metric: str | None = None

    @property
    def before(self) -> ChannelErrors:
        """Its errors under the baseline."""
        before = self.noise_floor if self.noise_floor_before is None else self.noise_floor_before
        return self._errors("before", before)

    @property
    def after(self) -> ChannelErrors:
        """Its errors under the final model."""
        return self._errors("after", self.noise_floor)

    def _errors(self, when: str, noise_floor: Number) -> ChannelErrors:
        figures = {name: getattr(self, f"{name}_{when}") for name in BEFORE_AND_AFTER}
        return ChannelErrors(
            channel=self.channel,
            joint=self.joint,
            unit=self.unit,
            noise_floor=noise_floor,
            metric=self.metric,
            **figures,
        )


class RecordingImprovement(Part):
    """Errors in one of several recordings under baseline and final model."""

    recording: int
    per_channel: tuple[ChannelImprovement, ...]


class ShorterWindows(Part):
    """The headline of baseline and final model on windows as short as those of the search."""

    horizon: Number = None
    rmse_before: Number
    rmse_after: Number


class Improvement(Part):
    """The improvement of predictions by the final model, on data that the search did not use.

    Attributes:
        data: ``test`` or ``heldout``.
        parts: Whether these are parts of a recording between parts that the search used.
        metric: ``windowed_simulation`` or ``inverse_dynamics``.
        horizon: Length of the simulated windows, s.
        rmse_before: The headline of the baseline: in the output's unit, or, with several outputs, the mean
            over their noise floors.
        rmse_after: The same of the final model.
        noise_floor: The RMSE of a perfect model.
        r2_before: Mean R², a fraction.
        r2_after: The same of the final model.
        per_channel: The same of each output.

    Example:
        >>> import labhil as lh
        >>> better = lh.load("examples/diagnosis.json").improvement
        >>> round(better.r2_after, 3), better.rmse_after < 1.1 * better.noise_floor
        (1.0, True)
    """

    data: str = "heldout"
    parts: bool = False
    metric: str = "windowed_simulation"
    horizon: Number = None
    rmse_before: Number
    rmse_after: Number
    noise_floor: Number = None
    mse_before: Number = None
    mse_after: Number = None
    r2_before: Number = None
    r2_after: Number = None
    per_channel: tuple[ChannelImprovement, ...] = ()
    per_recording: tuple[RecordingImprovement, ...] = ()
    shorter_windows: ShorterWindows | None = None

    @property
    def before(self) -> Score:
        """The errors of the baseline, like those of a fit."""
        return self._score("before")

    @property
    def after(self) -> Score:
        """The errors of the final model, like those of a fit."""
        return self._score("after")

    def _score(self, when: str) -> Score:
        return Score(
            metric=self.metric,
            horizon=self.horizon,
            rmse=getattr(self, f"rmse_{when}"),
            r2=getattr(self, f"r2_{when}"),
            noise_floor=self.noise_floor,
            per_channel=tuple(getattr(row, when) for row in self.per_channel),
            per_recording=tuple(
                RecordingErrors(
                    recording=recording.recording,
                    per_channel=tuple(getattr(row, when) for row in recording.per_channel),
                )
                for recording in self.per_recording
            ),
        )

    @property
    def unit(self) -> str:
        """Unit of the headline; empty where it is in noise floors, of several channels."""
        scored = [row for row in self.per_channel if row.metric in (None, self.metric)]
        return scored[0].unit if len(scored) == 1 else ""
