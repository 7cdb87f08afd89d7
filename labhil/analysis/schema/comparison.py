"""A comparison of models in its JSON (`labhil.comparison/1`)."""

from __future__ import annotations

from typing import Literal

from labhil.analysis.schema.parts import ChannelErrors, Interval, Number, Part, Source


class ComparedChannel(ChannelErrors):
    """Errors of one model in one output; ``rmse_over_noise`` is ``rmse`` over ``noise_floor``."""

    rmse_over_noise: Number = None


class ComparedModel(Part):
    """One model of a comparison.

    Attributes:
        name: Its name in the comparison.
        path: Its file.
        made_by: The kind of study that made it.
        terms: Its terms.
        n_parameters: Number of its estimated parameters.
        adequacy: Whether it explains the data.
        rmse_over_noise: RMSE of all outputs, in noise levels that are the same for all models.
        per_channel: Errors of each output.
        times_best: ``rmse_over_noise`` over that of the best model.
        p_value: Of the test that it is no worse than the best model.
        worse_than_best: Whether it is significantly worse.
        fitted_to_it: Whether it was fitted to these data.
    """

    name: str
    path: str
    made_by: Literal["fit", "diagnosis"]
    terms: tuple[str, ...]
    n_parameters: int
    adequacy: Literal["explained", "unexplained", "worse_than_mean"]
    rmse_over_noise: Number
    per_channel: tuple[ComparedChannel, ...]
    times_best: Number
    p_value: Number
    worse_than_best: bool
    fitted_to_it: bool = False


class ValueOfModel(Part):
    """A parameter's value in one model; ``std_error`` is None where it was held or is unknown."""

    model: str
    value: Number
    std_error: Number = None
    ci99: Interval | None = None
    held: bool = False
    identifiable: bool = True


class SharedParameter(Part):
    """A parameter that two models or more have.

    ``z`` is the largest difference of two values over its standard error, ``p_value`` is corrected for all
    pairs; ``agree`` is None where the data do not decide.
    """

    name: str
    joint: int | None = None
    unit: str = ""
    values: tuple[ValueOfModel, ...]
    z: Number = None
    p_value: Number = None
    agree: bool | None


class ComparisonPart(Part):
    """`labhil.comparison/1`. ``verdict`` is "alike" where other models are as good as ``best``."""

    recordings: tuple[Source, ...]
    rig: str
    metric: str
    horizon: Number
    verdict: Literal["one_best", "alike"]
    statement: str
    best: str
    preferred: str
    alpha: float
    models: tuple[ComparedModel, ...]
    parameters: tuple[SharedParameter, ...] = ()
    next_steps: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    seconds: Number = None

    @property
    def best_model(self) -> ComparedModel:
        """The model with the smallest error."""
        return next(model for model in self.models if model.name == self.best)
