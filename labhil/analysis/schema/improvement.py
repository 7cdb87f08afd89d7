"""How much better the final model of a diagnosis is, as the JSON says it (`labhil.diagnosis/1`)."""

from __future__ import annotations

from labhil.analysis.schema.parts import ChannelErrors, Number, Part, RecordingErrors, Score

BEFORE_AND_AFTER = ("mse", "rmse", "max_abs_error", "r2", "relative_error")
"""Figures of a channel that are stated of the model before and after."""


class ChannelImprovement(Part):
    """One channel before and after."""

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
        """Its errors with the model before the search."""
        before = self.noise_floor if self.noise_floor_before is None else self.noise_floor_before
        return self._errors("before", before)

    @property
    def after(self) -> ChannelErrors:
        """Its errors with the final model."""
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
    """One of several recordings before and after."""

    recording: int
    per_channel: tuple[ChannelImprovement, ...]


class ShorterWindows(Part):
    """The headline before and after on windows as short as the search's."""

    horizon: Number = None
    rmse_before: Number
    rmse_after: Number


class Improvement(Part):
    """How much better the final model predicts data that the search never saw.

    Attributes:
        data: ``test`` or ``heldout``.
        parts: Whether these are parts of a recording of which the search saw the parts between.
        metric: ``windowed_simulation`` or ``inverse_dynamics``.
        horizon: Length of the simulated windows, s.
        rmse_before: The headline of the model as it was: in the output's unit, or, with several outputs, the
            mean over their noise floors.
        rmse_after: The same of the final model.
        noise_floor: What a perfect model would reach.
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
        """The errors of the model before the search, as of a fit."""
        return self._score("before")

    @property
    def after(self) -> Score:
        """The errors of the final model, as of a fit."""
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
        """Of the headline, which is in multiples of noise floors where it is of several channels."""
        scored = [row for row in self.per_channel if row.metric in (None, self.metric)]
        return scored[0].unit if len(scored) == 1 else ""
