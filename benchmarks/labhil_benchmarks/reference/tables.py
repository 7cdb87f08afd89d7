"""From the parts of a study to the tables of the text, filled."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from labhil.identify.linear import Figures
from labhil_benchmarks.reference.published import Quality
from labhil_benchmarks.reference.result import (
    NAMES,
    Estimated,
    Figure,
    Limits,
    LinearModels,
    Row,
    ScoreRow,
    Table,
    Way,
)
from labhil_benchmarks.reference.study import Study

OURS = (Way.SWARM, Way.ROUGH, Way.DEFAULT)
PRINTED = {Way.TEXT_PSO: "PSO", Way.TEXT_NLSE: "NLSE"}
CEILING = "truth (ceiling)"


@dataclass(frozen=True, slots=True)
class Computed:
    """All parts of one study."""

    study: Study
    limits: Limits
    ways: Mapping[Way, Estimated]
    linear: LinearModels | None

    @property
    def values(self) -> Mapping[Way, Sequence[float]]:
        """Values of the rows by way, the text's included."""
        rows = self.study.parameters.rows
        text = {Way.TEXT_PSO: [row.pso for row in rows], Way.TEXT_NLSE: [row.nlse for row in rows]}
        return {**text, **{way: estimated.values for way, estimated in self.ways.items()}}


def tables_of(computed: Computed) -> tuple[Table, ...]:
    """Every table that this study fills."""
    study = computed.study
    made = [linear_table(computed, computed.linear)] if computed.linear is not None else []
    made.append(parameter_table(computed))
    if study.combinations:
        made.append(combination_table(computed))
    return (*made, score_table(computed))


def parameter_table(computed: Computed) -> Table:
    """A row per parameter: the text's values and ours against truth and bound."""
    study, limits = computed.study, computed.limits
    rows = []
    for i, (row, truth) in enumerate(zip(study.parameters.rows, study.truth, strict=True)):
        bound = limits.bounds[i]
        belief = computed.ways[Way.DEFAULT].belief
        assert belief is not None
        window_bound = belief.bounds[i]
        figures = {
            str(way): Figure.of(values[i], truth, window_bound if way is Way.DEFAULT else bound)
            for way, values in computed.values.items()
        }
        value, reach = computed.values[Way.DEFAULT][i], belief.text_reach[i]
        known = bound is not None
        rows.append(
            Row(
                symbol=row.symbol,
                joint=row.joint,
                unit=row.unit,
                truth=truth,
                bound=bound,
                figures=figures,
                default_bound=window_bound,
                std_error=belief.std_errors[i] if known else None,
                interval=(belief.low[i], belief.high[i]) if known else None,
                text_formula=(value - reach, value + reach) if known else None,
                text_interval=row.interval,
                text_errors=row.errors,
            )
        )
    notes = (*effort_notes(computed), *unknown_notes(computed))
    return Table(
        study.parameters.number, study.parameters.title, study.variant, study.setup, tuple(rows), notes=notes
    )


def combination_table(computed: Computed) -> Table:
    """What the data know where single values are open: the same ways, as functions of the rows."""
    study, limits = computed.study, computed.limits
    truth = study.combined(study.truth)
    values = {way: study.combined(rows) for way, rows in computed.values.items()}
    rows = tuple(
        Row(
            symbol=combination.label,
            joint=None,
            unit=combination.unit,
            truth=truth[i],
            bound=limits.combined[i],
            figures={str(way): Figure.of(v[i], truth[i], limits.combined[i]) for way, v in values.items()},
            default_bound=limits.combined[i],
            std_error=None,
            interval=None,
            text_formula=None,
            text_interval=None,
            text_errors=None,
        )
        for i, combination in enumerate(study.combinations)
    )
    note = (
        "Resistance and inductance times a, inertia and every torque divided by a, change no digit of the "
        "speed for any a: these combinations are what a recording of speed alone can know, however long it "
        "is."
    )
    variant = "what speed alone does know"
    return Table(study.parameters.number, study.parameters.title, variant, study.setup, rows, notes=(note,))


def score_table(computed: Computed) -> Table:
    """Errors on the test run: the text's printed values in our plant's data, ours, and the truth's."""
    study, limits = computed.study, computed.limits
    models: list[tuple[str, Sequence[Figures], str | None]] = [
        (f"{NAMES[Way.TEXT_PSO]}, its values", limits.text_pso, "PSO"),
        (f"{NAMES[Way.TEXT_NLSE]}, its values", limits.text_nlse, "NLSE"),
    ]
    models += [(NAMES[way], computed.ways[way].scores, None) for way in OURS]
    models.append((CEILING, limits.scores, None))
    printed = study.quality.rows if len(limits.scores) != 2 else ()
    rows = [row for name, scores, key in models for row in _score_rows(study, name, scores, key, printed)]
    notes = (
        "R² of the truth is the ceiling that the noise allows. One run over the whole test recording from "
        "its known start, as in the text. What the text prints under MSE bears the unit "
        f"{study.quality.printed_unit}, a root's; ours are mean squares, with the root beside them.",
    )
    return Table(
        study.quality.number, study.quality.title, study.variant, study.setup, scores=tuple(rows), notes=notes
    )


def linear_table(computed: Computed, linear: LinearModels) -> Table:
    """Linear and nonlinear models on the same test run."""
    study = computed.study
    assert study.linear is not None
    printed = study.linear.rows
    rows = [
        row
        for name, score in zip(linear.names, linear.scores, strict=True)
        for row in _score_rows(study, name, [score], name, printed)
    ]
    for name, way, key in (
        (NAMES[Way.ROUGH], Way.ROUGH, "NLSE"),
        (NAMES[Way.SWARM], Way.SWARM, "PSO"),
        (NAMES[Way.DEFAULT], Way.DEFAULT, None),
    ):
        rows += _score_rows(study, name, computed.ways[way].scores, key, printed)
    rows += _score_rows(study, CEILING, computed.limits.scores, None, printed)
    notes = tuple(f"{name}: {text}" for name, text in zip(linear.names, linear.equations, strict=True))
    number, title = study.linear.number, study.linear.title
    return Table(number, title, study.variant, study.setup, scores=tuple(rows), notes=notes)


def _score_rows(
    study: Study, name: str, scores: Sequence[Figures], key: str | None, printed: Sequence[Quality]
) -> list[ScoreRow]:
    """A row per channel; ``key`` is the model's name in the ``printed`` table, None where it has none."""
    rows = []
    for j, (score, (channel, unit)) in enumerate(zip(scores, channels_of(study, len(scores)), strict=True)):
        joint = j if study.torque_constant else None
        matching = [row for row in printed if row.model == key and row.joint == joint]
        rows.append(
            ScoreRow(
                model=name,
                channel=channel,
                joint=joint,
                unit=unit,
                mse=score.mse,
                rmse=score.rmse,
                r2=100.0 * score.r2,
                max_abs_error=score.max_abs_error,
                printed_mse=matching[0].mse if matching else None,
                printed_r2=matching[0].r2 if matching else None,
            )
        )
    return rows


def channels_of(study: Study, count: int) -> list[tuple[str, str]]:
    """Name and unit of each channel whose errors are judged."""
    if study.torque_constant:
        return [("torque", "N·m")] * count
    if study.quality.printed_unit == "rad/s":
        return [("speed", "rad/s"), ("current", "A")][:count]
    return [("position", "m")] * count


def effort_notes(computed: Computed) -> tuple[str, ...]:
    """How well each way fits the training run, and how many rough starts come home."""
    rough, default = computed.ways[Way.ROUGH], computed.ways[Way.DEFAULT]
    residuals = ", ".join(
        f"{NAMES[way].removeprefix('ours: ')} {computed.ways[way].residual:.4g}" for way in OURS
    )
    window = default.belief.window if default.belief is not None else 0.0
    return (
        f"Residual of one run over the training recording in units of the noise (1 is perfect): {residuals}.",
        f"Of {rough.starts} rough starts, every value off by a factor between 1/3 and 3, least squares led "
        f"{rough.reached} to the lowest minimum; the column shows the first.",
        f"The default fits windows of {window:.3g} s with initial states of their own; its errors are in "
        "bounds (σ) of these windows, all others in bounds of one run from a known start.",
    )


def unknown_notes(computed: Computed) -> tuple[str, ...]:
    """Rows that the data do not know."""
    pairs = zip(computed.study.labels, computed.limits.bounds, strict=True)
    unknown = [label for label, bound in pairs if bound is None]
    if not unknown:
        return ()
    return (f"Without a bound, because these data do not know them: {', '.join(unknown)}.",)
