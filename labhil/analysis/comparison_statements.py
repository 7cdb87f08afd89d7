"""The answer of a comparison as a sentence, and the next steps."""

from __future__ import annotations

import shlex

from labhil.analysis.rig_option import rig_option
from labhil.analysis.schema import ComparedModel, ComparisonPart
from labhil.physics.terms import enumerated, keyed


def statement(comparison: ComparisonPart) -> str:
    """Return which model explains the recording best, by how much, and whether that is more than noise."""
    best = comparison.best_model
    others = sorted(
        (model for model in comparison.models if model.name != best.name),
        key=lambda model: model.times_best or 1e300,
    )
    equally_good = [model for model in others if not model.worse_than_best]
    noun = "recordings" if len(comparison.recordings) > 1 else "recording"
    if not equally_good:
        return (
            f"{best.name} explains the {noun} best, {_error_phrase(best)}; next is {others[0].name} with "
            f"{_ratio_phrase(others[0])} its error, more than noise ({_p_phrase(others[0])})."
        )
    names = [model.name for model in comparison.models if model is best or model in equally_good]
    worse = [model for model in others if model.worse_than_best]
    next_worse = min(worse, key=lambda model: model.times_best or 1e300, default=None)
    addition = (
        "" if next_worse is None else f"; {next_worse.name} has {_ratio_phrase(next_worse)} their error"
    )
    largest_difference = max((model.times_best or 1.0) - 1.0 for model in equally_good)
    nearest = min(equally_good, key=lambda model: model.p_value or 0.0)
    return (
        f"{enumerated(names)} explain the {noun} alike, {_error_phrase(best)}: their errors differ by "
        f"{100 * largest_difference:.2g} %, no more than noise ({_p_phrase(nearest)}){addition}."
    )


def _error_phrase(model: ComparedModel) -> str:
    size = "–" if model.rmse_over_noise is None else f"{model.rmse_over_noise:.3g}"
    if model.adequacy == "explained":
        return f"to the noise (error {size} noise levels)"
    if model.adequacy == "worse_than_mean":
        return f"but worse than its mean would (error {size} noise levels)"
    return f"but not to the noise (error {size} noise levels)"


def _model_file(model: ComparedModel) -> str:
    """The file of a model, or a placeholder where the result was never saved."""
    return shlex.quote(model.path) if model.path.endswith(".json") else "MODEL.json"


def _ratio_phrase(model: ComparedModel) -> str:
    return "far more than" if model.times_best is None else f"{model.times_best:.3g} times"


def _p_phrase(model: ComparedModel) -> str:
    value = model.p_value or 0.0
    return "p < 1e-99" if value < 1e-99 else f"p = {value:.2g}"


def next_steps(comparison: ComparisonPart) -> list[str]:
    """Return the next steps, the most useful first."""
    best, steps = comparison.best_model, list[str]()
    path, rig = shlex.quote(comparison.recordings[0].path), rig_option(comparison.recordings[0])
    preferred = next(model for model in comparison.models if model.name == comparison.preferred)
    if best.adequacy != "explained":
        steps.append(
            "No model explains the data to the noise:"
            f" `labhil diagnose {path} --model {_model_file(best)}{rig}` names what the best one lacks."
        )
    if comparison.verdict == "alike":
        steps.append(
            f"Take {comparison.preferred}: it has {preferred.n_parameters} parameters, no model that "
            "explains the data as well has fewer. A longer recording, or one with other amplitudes and "
            "frequencies, may tell them apart."
        )
    fitted = [model.name for model in comparison.models if model.fitted_to_it]
    if fitted:
        steps.append(
            "Compare on a recording that none of them was fitted to:"
            f" `labhil compare … --recording NEW.mcap{rig}`."
        )
    elif best.adequacy == "explained":
        steps.append(
            "Hold the next recording against it:"
            f" `labhil verify NEW.mcap --model {_model_file(preferred)}{rig}`."
        )
    disagreeing = [keyed(row.name, row.joint) for row in comparison.parameters if row.agree is False]
    if disagreeing:
        steps.append(
            f"The models disagree about {', '.join(disagreeing)}: where they have different terms, one takes "
            "up what the other lacks; where they have the same terms, the rig has changed between their "
            "recordings."
        )
    return steps
