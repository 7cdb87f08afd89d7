"""Where the text's own claims do not stand, each sentence computed from its numbers or from ours."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from labhil.physics.terms import keyed
from labhil_benchmarks.reference.published import (
    TABLE_5_1,
    TABLE_5_3,
    TABLE_5_4,
    TABLE_5_5,
    TABLE_5_6,
    TABLE_5_8,
    TABLE_5_9,
    TABLE_5_10,
    TABLE_5_11,
    TABLE_5_12,
    TABLE_5_13,
    TABLE_5_14,
    TABLE_5_15,
)
from labhil_benchmarks.reference.result import Way
from labhil_benchmarks.reference.tables import Computed

PARAMETER_TABLES = (TABLE_5_3, TABLE_5_5, TABLE_5_8, TABLE_5_10, TABLE_5_12, TABLE_5_14)
QUALITY_TABLES = (TABLE_5_1, TABLE_5_4, TABLE_5_6, TABLE_5_9, TABLE_5_11, TABLE_5_13, TABLE_5_15)
ROUNDING = 0.6
"""Points of % by which a printed error may differ from the one that its own value has."""


def findings(all_computed: Sequence[Computed]) -> tuple[str, ...]:
    """Every finding that these studies support, the text's own arithmetic last."""
    texts = [text for computed in all_computed if (text := below_the_bound(computed))]
    over_all = (swarm_against_least_squares, default_against_bounds, intervals)
    texts += [text for finding in over_all if (text := finding(all_computed))]
    texts += [text for computed in all_computed if (text := at_the_edge(computed))]
    texts += [text for computed in all_computed if (text := ceiling(computed))]
    texts += [text for computed in all_computed if (text := noise_of_the_arm(computed))]
    return (*texts, *own_arithmetic())


def below_the_bound(computed: Computed) -> str:
    """Rows that the text prints closer to the truth than the data allow."""
    study, limits = computed.study, computed.limits
    rows = list(zip(study.parameters.rows, study.labels, study.truth, limits.bounds, strict=True))
    if all(row.real is None for row, *_ in rows):
        return ""
    unknown = [label for _, label, truth, bound in rows if bound is None and truth]
    worst = max(
        (abs(row.pso / truth - 1.0) for row, _, truth, bound in rows if bound is None and truth), default=0.0
    )
    wide = [
        f"{label} {100 * abs(row.pso / truth - 1):.2g} % (bound {100 * bound / abs(truth):.2g} %)"
        for row, label, truth, bound in rows
        if bound is not None and truth and abs(row.pso - truth) < 0.5 * bound
    ]
    name = f"Table {study.parameters.number}" + (f", {study.variant}" if study.variant else "")
    texts = []
    if unknown and study.held:
        texts.append(
            f"{', '.join(unknown)} cannot be known from this recording at all, whatever the estimator and "
            f"however long it is; the text prints them with at most {100 * worst:.2g} % error"
        )
    if wide:
        texts.append(
            f"closer to the truth than half a standard error of the best estimator: {', '.join(wide)}"
        )
    return f"{name}: {'; '.join(texts)}." if texts else ""


def swarm_against_least_squares(all_computed: Sequence[Computed]) -> str:
    """What a swarm's lead is worth once least squares begin well."""
    texts, rough_wins, default_wins, shares = [], 0, 0, []
    for computed in all_computed:
        swarm, rough, default = (computed.ways[way] for way in (Way.SWARM, Way.ROUGH, Way.DEFAULT))
        texts.append(
            f"{computed.study.name} {swarm.residual:.4g} / {rough.residual:.4g} / {default.residual:.4g} "
            f"({rough.reached} of {rough.starts})"
        )
        rough_wins += rough.residual <= swarm.residual
        default_wins += default.residual <= swarm.residual
        shares.append(rough.evaluations / swarm.evaluations)
    if not texts:
        return ""
    return (
        "The text's lead of PSO over least squares is a matter of the start. Residual of the training run in "
        "units of noise, swarm / first rough start / default, and how many rough starts led least squares to "
        f"the lowest minimum: {'; '.join(texts)}. The one least squares from a rough start ends at or below "
        f"the swarm in {rough_wins} of {len(texts)} cases, after {100 * float(np.median(shares)):.1g} % of "
        f"its simulations (median); the default, which is not told where the truth lies, in {default_wins}."
    )


def default_against_bounds(all_computed: Sequence[Computed]) -> str:
    """How the default's errors compare with the bounds of its windows."""
    errors = []
    for computed in all_computed:
        default, study = computed.ways[Way.DEFAULT], computed.study
        bounds = default.belief.bounds if default.belief is not None else ()
        errors += [
            (abs(value - truth) / bound, f"{study.name} {label}")
            for value, truth, bound, label in zip(
                default.values, study.truth, bounds, study.labels, strict=True
            )
            if bound is not None
        ]
    if not errors:
        return ""
    far = [f"{name} {size:.1f}" for size, name in sorted(errors, reverse=True) if size > 3.0]
    text = (
        f"Our default: the median error over {len(errors)} values that have a bound is "
        f"{float(np.median([size for size, _ in errors])):.2f} bounds (a normal error: 0.67)"
    )
    return f"{text}; beyond three bounds: {', '.join(far)}." if far else f"{text}, none beyond three."


def intervals(all_computed: Sequence[Computed]) -> str:
    """Coverage of the text's formula and of ours over all rows that have a bound."""
    ours = text = count = 0
    for computed in all_computed:
        default = computed.ways[Way.DEFAULT]
        belief = default.belief
        if belief is None:
            continue
        for i, (truth, bound) in enumerate(zip(computed.study.truth, computed.limits.bounds, strict=True)):
            if bound is None:
                continue
            count += 1
            ours += belief.low[i] <= truth <= belief.high[i]
            text += abs(default.values[i] - truth) <= belief.text_reach[i]
    if not count:
        return ""
    return (
        "Its intervals, ±2.58·SE/√n (eq. 3.16 and 3.19), divide by √n what was divided already: around our "
        f"default estimates they contain the truth {text} times in {count} where 99 % are promised; "
        f"intervals with the robust covariance do so {ours} times."
    )


def ceiling(computed: Computed) -> str:
    """R² that the text prints against the ceiling, and against that of its own values."""
    study, limits = computed.study, computed.limits
    printed = [row for row in study.quality.rows if row.model == "PSO"]
    if len(printed) != len(limits.scores):
        return ""
    parts = []
    for row, truth, of_text in zip(printed, limits.scores, limits.text_pso, strict=True):
        prefix = f"joint {row.joint}: " if row.joint is not None else ""
        parts.append(
            f"{prefix}printed {row.r2:g}, its values {100 * of_text.r2:.4g}, ceiling {100 * truth.r2:.4g}"
        )
    return (
        f"Table {study.quality.number}: R² (%) of the PSO column on our test run: {'; '.join(parts)}. A "
        "printed R² below that of the printed values means more noise, or other data, than the text states."
    )


def at_the_edge(computed: Computed) -> str:
    """Values far nearer to zero than any estimate with noise could be."""
    study, limits = computed.study, computed.limits
    tiny = [
        (label, row.pso, bound)
        for row, label, truth, bound in zip(
            study.parameters.rows, study.labels, study.truth, limits.bounds, strict=True
        )
        if truth == 0.0 and bound is not None and 0.0 < row.pso < 0.01 * bound
    ]
    if not tiny:
        return ""
    label, value, bound = min(tiny, key=lambda item: item[1])
    return (
        f"Table {study.parameters.number}: {', '.join(item[0] for item in tiny)} are printed at less than a "
        f"hundredth of their standard error ({label} {value:.2g}, bound {bound:.2g}). No estimate of a zero "
        "comes out like that: it is the edge of the swarm's box, and its p value of 1 the edge's."
    )


def noise_of_the_arm(computed: Computed) -> str:
    """What the text's own residuals would do to the bounds of the joints."""
    study, limits = computed.study, computed.limits
    if not study.torque_constant:
        return ""
    printed = [row for row in study.quality.rows if row.model == "PSO"]
    wider = [np.sqrt(row.mse) / truth.rmse for row, truth in zip(printed, limits.scores, strict=True)]
    examples = []
    for row, truth, bound in zip(study.parameters.rows, study.truth, limits.bounds, strict=True):
        if row.symbol == "τ_s" and bound is not None and row.joint is not None:
            examples.append(f"joint {row.joint} {100 * bound * wider[row.joint] / truth:.2g} %")
    return (
        f"Table {study.parameters.number}: the text's own residuals (roots of its MSE) are {min(wider):.2g} "
        f"to {max(wider):.2g} times our noise. With residuals of that size the bound of τ_s would be: "
        f"{', '.join(examples)}; the text's intervals are ±4 to ±17 %."
    )


def own_arithmetic() -> tuple[str, ...]:
    """Faults that need no data: the text's tables against themselves."""
    return (
        f"Printed errors that do not follow from the printed values (%): {'; '.join(wrong_errors())}.",
        f"Estimates outside of their own printed interval: {'; '.join(outside_of_interval())}.",
        "Static below Coulomb friction, so that friction rises as motion sets in: "
        f"{'; '.join(upside_down())}.",
        "MSE and R² of one table give the variance of the same output, MSE/(1 − R²), which must not depend "
        f"on the model: {'; '.join(implied_variances())}.",
    )


def wrong_errors() -> list[str]:
    """Rows whose printed error is not that of the printed value."""
    rows = []
    for table in PARAMETER_TABLES:
        for row in table.rows:
            if not row.errors or not row.real:
                continue
            for name, value, text in zip(("PSO", "NLSE"), (row.pso, row.nlse), row.errors, strict=True):
                error = 100.0 * abs(value - row.real) / abs(row.real)
                if text[0] in "<≈":
                    continue
                if abs(error - float(text)) > ROUNDING:
                    rows.append(f"{table.number} {row.symbol} {name} {text}, its value {error:.3g}")
    return rows


def outside_of_interval() -> list[str]:
    """Rows whose interval does not contain the estimate that it is built around."""
    return [
        f"{table.number} {keyed(row.symbol, row.joint)} {row.pso:g} in [{row.interval[0]:g}, "
        f"{row.interval[1]:g}]"
        for table in PARAMETER_TABLES
        for row in table.rows
        if row.interval is not None and not row.interval[0] <= row.pso <= row.interval[1]
    ]


def upside_down() -> list[str]:
    """Tables, or their joints, whose static level is below the Coulomb level."""
    tables = []
    for table in PARAMETER_TABLES:
        levels = [row for row in table.rows if row.symbol in ("T_s", "F_s", "τ_s")]
        for row in levels:
            coulomb = next(r for r in table.rows if r.symbol == f"{row.symbol[0]}_c" and r.joint == row.joint)
            if row.pso < coulomb.pso:
                where = "" if row.joint is None else f" joint {row.joint}"
                tables.append(f"{table.number}{where} {row.pso:g} < {coulomb.pso:g}")
    return tables


def implied_variances() -> list[str]:
    """Smallest and largest variance of the output that each table's rows imply."""
    ranges = []
    for table in QUALITY_TABLES:
        joints = dict.fromkeys(row.joint for row in table.rows)
        for joint in joints:
            implied = [row.mse / (1.0 - row.r2 / 100.0) for row in table.rows if row.joint == joint]
            where = "" if joint is None else f" joint {joint}"
            if max(implied) > 1.2 * min(implied):
                ranges.append(f"{table.number}{where} {min(implied):.2g} to {max(implied):.2g}")
    return ranges
