"""The page of a diagnosis: verdict, location, missing terms, improvement, exclusions."""

from __future__ import annotations

from collections.abc import Sequence

from labhil.analysis.schema import (
    ChannelImprovement,
    DiagnosisPart,
    Improvement,
    Interval,
    Location,
    MissingEffect,
    Rival,
)
from labhil.analysis.verdicts import NOT_TESTED, VERDICTS, disagreement
from labhil.physics.terms import keyed
from labhil.report.exclusions import TermLimits, group_undecided, joints_in, limits_by_joint
from labhil.report.formatting import (
    NOTHING,
    format_interval,
    format_multiple,
    format_p_value,
    format_percent,
    format_probability,
    format_quantity,
)
from labhil.report.html.curve import curve_picture
from labhil.report.html.element import Content, Markup, join, tag
from labhil.report.html.model import (
    bars,
    channel_name,
    intervals_picture,
    name_code,
    names,
    next_steps_section,
    parameters_table,
    recordings_table,
    warning,
)
from labhil.report.html.page import Page, PageSection, drop_empty, section
from labhil.report.html.picture import Album
from labhil.report.html.table import bullets, facts, numbers, table, text, tiles

P_VALUES = {
    "bootstrap": "It was counted in a bootstrap",
    "tail_extrapolated": "It is extrapolated from the tail of a theoretical distribution: "
    "only its order of magnitude is reliable",
}


def diagnosis_page(
    diagnosis: DiagnosisPart, foot: str, album: Album, pictures: Sequence[Markup] = ()
) -> Page:
    """Make the page of a diagnosis.

    Args:
        diagnosis: The result.
        foot: Last line of the page: where it comes from.
        album: The pictures of the page.
        pictures: Pictures that need the samples; they are shown under the scores.
    """
    rig = ", ".join(dict.fromkeys(source.rig for source in diagnosis.recordings))
    return Page(
        kind=f"Diagnosis of a model and a recording · {rig}"
        if rig
        else "Diagnosis of a model and a recording",
        title=f"Diagnosis: {VERDICTS[diagnosis.verdict].rstrip('.')}",
        headline=VERDICTS[diagnosis.verdict],
        tone=diagnosis.verdict,
        lead=_lead(diagnosis),
        sections=drop_empty(
            next_steps_section(diagnosis.next_steps),
            section("Faults of the data", *(tag("p", fault.statement) for fault in diagnosis.faults)),
            section(
                "Sizes that a fit took to absurd values",
                *(tag("p", size.statement) for size in diagnosis.collapsed),
            ),
            section(
                "What is missing", *(_missing_effect(item, diagnosis.rivals) for item in diagnosis.missing)
            ),
            _changes(diagnosis),
            _location(diagnosis.location),
            _improvement(diagnosis.improvement, pictures),
            section(
                "The estimated curve",
                *(curve_picture(album, curve) for curve in (diagnosis.curve, *diagnosis.further_curves)),
            ),
            _final_model(diagnosis, album),
            _rivals(diagnosis.rivals),
            _exclusions(diagnosis),
            _undecided_terms(diagnosis),
            _method(diagnosis),
        ),
        foot=foot,
    )


def _lead(diagnosis: DiagnosisPart) -> tuple[Content, ...]:
    missing = [keyed(item.term, item.joint) for item in diagnosis.missing]
    effects = tag("p", "Missing: ", names(missing), ".", class_="lead") if missing else None
    location = diagnosis.location
    statement = tag("p", location.statement, class_="lead") if location else None
    remainder = diagnosis.remainder
    unexplained = tag("p", remainder.statement, class_="lead") if remainder else None
    return effects, statement, unexplained, _figures(diagnosis)


def _figures(diagnosis: DiagnosisPart) -> Markup:
    improvement = diagnosis.improvement
    entries: list[tuple[str, Content, Content]] = [
        ("p that the baseline suffices", format_p_value(diagnosis.p_value), join(_p_value_method(diagnosis)))
        if diagnosis.asks_baseline
        else ("The baseline", NOTHING, NOT_TESTED)
    ]
    if improvement is not None:
        unit = improvement.unit
        entries += [
            (
                "RMSE before",
                format_quantity(improvement.rmse_before, unit),
                _floor_multiple(improvement.rmse_before, improvement),
            ),
            (
                "RMSE after",
                format_quantity(improvement.rmse_after, unit),
                _floor_multiple(improvement.rmse_after, improvement),
            ),
            (
                "R² after",
                format_percent(improvement.r2_after),
                f"{format_percent(improvement.r2_before)} before, {_test_data(improvement)}",
            ),
        ]
    return tiles(entries)


def _floor_multiple(rmse: float | None, improvement: Improvement) -> str:
    return f"{format_multiple(rmse, improvement.noise_floor)} the noise floor"


def _test_data(improvement: Improvement) -> str:
    return "on the test recording" if improvement.data == "test" else "on held-out data"


def _p_value_method(diagnosis: DiagnosisPart) -> list[Content]:
    method = (
        "extrapolated from the tail" if diagnosis.p_value_method == "tail_extrapolated" else "by bootstrap"
    )
    return [method if diagnosis.p_value_method in P_VALUES else diagnosis.p_value_method]


def _missing_effect(item: MissingEffect, rivals: Sequence[Rival]) -> Markup:
    evidence = item.evidence
    evidence_facts = facts(
        (
            ("ΔBIC, with against without", format_quantity(evidence.delta_bic)),
            ("Gain on held-out data", format_quantity(evidence.heldout_loglik_gain, "nats")),
            ("p that it gains nothing", format_p_value(evidence.p_value)),
        ),
        "row",
    )
    alternatives = [r for r in rivals if (r.instead_of, r.joint) == (item.term, item.joint)]
    return tag(
        "article",
        tag(
            "h3",
            keyed(item.term, item.joint),
            tag("span", "probability ", format_probability(item.probability), class_="remark"),
        ),
        tag("p", item.statement),
        tag("p", item.equation, class_="equation") if item.equation else None,
        parameters_table(item.parameters, f"Parameters of {keyed(item.term, item.joint)}"),
        evidence_facts,
        _alternatives(alternatives),
        class_="card",
    )


def _alternatives(rivals: Sequence[Rival]) -> Markup | None:
    if not rivals:
        return None
    others = ", ".join(f"{keyed(r.term, r.joint)} ({format_probability(r.probability)})" for r in rivals)
    return tag("p", f"It might be, instead: {others}.")


def _changes(diagnosis: DiagnosisPart) -> PageSection | None:
    if not diagnosis.changed:
        return None
    rows = [
        (
            name_code(change.name, change.joint, change.recording),
            format_quantity(change.before, change.unit),
            format_quantity(change.after, change.unit),
            format_interval(change.ci99, change.unit),
            format_p_value(change.p_value),
        )
        for change in diagnosis.changed
    ]
    columns = (*text("Parameter"), *numbers("Before", "After", "99 % interval", "p"))
    return section("Parameters that have changed", table("Against the reference model", columns, rows))


def _location(location: Location | None) -> PageSection | None:
    if location is None:
        return None
    times = ", ".join(_time(span, location.times_in[i : i + 1]) for i, span in enumerate(location.times))
    details = facts(
        (
            ("Channel", tag("code", keyed(location.channel, location.joint))),
            ("It enters by", location.enters),
            *((("Times", times),) if times else ()),
        )
    )
    rows = [
        (
            tag("code", keyed(r.term, r.joint)),
            tag("code", r.coordinate),
            format_quantity(r.low, r.unit),
            format_quantity(r.high, r.unit),
            format_percent(r.share_of_excess),
        )
        for r in location.regimes
    ]
    columns = (*text("Effect", "Coordinate"), *numbers("From", "To", "Share of the excess"))
    regimes = table("Where each effect matters", columns, rows) if rows else None
    return section("Where the mismatch is", details, regimes)


def _time(span: Interval, recording: Sequence[int]) -> str:
    """A span of time, with the number of its recording where there are several."""
    return format_interval(span, "s") + "".join(f" of @{number}" for number in recording)


def _improvement(improvement: Improvement | None, pictures: Sequence[Markup]) -> PageSection | None:
    if improvement is None:
        return section("How much better the model predicts", *pictures)
    columns = (
        *text("Channel"),
        *numbers("RMSE before", "RMSE after", "Noise floor"),
        *text("Before, after, floor"),
        *numbers("R² before", "R² after"),
    )
    caption = "Before above after; the line is the noise floor, which a perfect model would reach"
    rows = [_channel(channel, improvement.metric) for channel in improvement.per_channel]
    for recording in improvement.per_recording:
        rows += [
            _channel(channel, improvement.metric, recording.recording) for channel in recording.per_channel
        ]
    return section(
        "How much better the model predicts",
        tag("p", _scoring(improvement)),
        table(caption, columns, rows) if rows else None,
        *pictures,
    )


def _scoring(improvement: Improvement) -> str:
    many = len(improvement.per_recording) > 1 and not improvement.parts
    if improvement.data == "test":
        data = "the test recordings" if many else "the test recording"
    else:
        data = "the held-out end of each recording" if many else "the held-out end of the recording"
    unseen = f"the parts of {data} that" if improvement.parts else f"{data}, which"
    if improvement.metric == "inverse_dynamics":
        return f"Scored by inverse dynamics on {unseen} the search never saw."
    horizon = format_quantity(improvement.horizon, "s")
    return f"Scored by simulating windows of {horizon} of {unseen} the search never saw."


def _channel(channel: ChannelImprovement, metric: str, recording: int | None = None) -> list[Content]:
    return [
        channel_name(channel, metric, recording),
        format_quantity(channel.rmse_before, channel.unit),
        format_quantity(channel.rmse_after, channel.unit),
        format_quantity(channel.noise_floor, channel.unit),
        bars(channel.rmse_before, channel.rmse_after, channel.noise_floor),
        format_percent(channel.r2_before),
        format_percent(channel.r2_after),
    ]


def _final_model(diagnosis: DiagnosisPart, album: Album) -> PageSection | None:
    final, disagreement_note = diagnosis.final, disagreement(diagnosis.scale_factor)
    return section(
        "Final model",
        tag("p", "Its terms: ", names(final.terms), "."),
        tag("p", disagreement_note) if disagreement_note else None,
        parameters_table(diagnosis.judged_rows, "Parameters of the final model, fitted to the search data"),
        intervals_picture(album, diagnosis.judged_rows),
    )


def _rivals(rivals: Sequence[Rival]) -> PageSection | None:
    if not rivals:
        return None
    columns = (
        *text("Rival", "Instead of"),
        *numbers("Probability", "ΔBIC"),
        *text("Can be told apart", "Experiment to tell them apart"),
    )
    rows = [
        (
            tag("code", keyed(rival.term, rival.joint)),
            tag("code", rival.instead_of),
            format_probability(rival.probability),
            format_quantity(rival.delta_bic, digits=3),
            "yes" if rival.distinguishable else "no",
            rival.experiment,
        )
        for rival in rivals
    ]
    return section("Rivals", table("Terms that explain the data about as well", columns, rows))


def _exclusions(diagnosis: DiagnosisPart) -> PageSection | None:
    if not diagnosis.excluded:
        return None
    without_joint = [item for item in diagnosis.excluded if item.joint is None]
    columns = (*text("Effect"), *numbers("Largest that could hide", "Confidence"))
    rows = [
        (
            tag("code", keyed(item.term, None, item.recording)),
            format_quantity(item.largest_hidden, item.unit, digits=3),
            f"{100 * item.confidence:.4g}\N{NO-BREAK SPACE}%" if item.confidence is not None else None,
        )
        for item in without_joint
    ]
    caption = "Effects that are absent, or smaller than this in their main parameter"
    return section(
        "What is not there",
        table(caption, columns, rows) if rows else None,
        _exclusions_by_joint(limits_by_joint(diagnosis.excluded)),
    )


def _exclusions_by_joint(limits: Sequence[TermLimits]) -> Markup | None:
    if not limits:
        return None
    joints = joints_in(limits)
    columns = (*text("Effect"), *numbers(*(f"Joint {joint}" for joint in joints)), *text("Unit"))
    rows = [
        (
            tag("code", row.term),
            *(format_quantity(row.largest.get(joint), digits=3) for joint in joints),
            row.unit if row.unit != "1" else None,
        )
        for row in limits
    ]
    return table("The same by joint, with 99 % confidence", columns, rows)


def _undecided_terms(diagnosis: DiagnosisPart) -> PageSection | None:
    if not diagnosis.undecided:
        return None
    lines = [
        join(
            (
                tag("code", term.name),
                f": {term.reason}",
                f"; it needs {', '.join(term.needs)}" if term.needs else None,
                ".",
            )
        )
        for term in group_undecided(diagnosis.undecided)
    ]
    return section("What these data cannot decide", bullets(lines))


def _method(diagnosis: DiagnosisPart) -> PageSection | None:
    parts: list[Content] = [recordings_table(diagnosis.recordings)]
    if diagnosis.p_value_method in P_VALUES:
        floor = f" A smaller one than {format_p_value(diagnosis.p_value_floor)} could not be counted."
        parts.append(
            tag(
                "p",
                f"The p value asks whether the baseline alone could give these data, over the whole search. "
                f"{P_VALUES[diagnosis.p_value_method]}.",
                floor if diagnosis.p_value_floor else None,
            )
        )
    parts += [
        tag("p", "The baseline: ", names(diagnosis.baseline.terms), "."),
        parameters_table(diagnosis.baseline.parameters, "The baseline's own parameters, fitted without more"),
        tag("p", f"The search took {format_quantity(diagnosis.seconds, 's', digits=3)}.", class_="quiet"),
    ]
    if not diagnosis.recordings:
        parts.insert(0, warning("The result names no recording that it comes from."))
    return section("Recordings and method", *parts)
