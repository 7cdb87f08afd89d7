"""A diagnosis as a page: verdict, where, what is missing, how much better, what could still hide."""

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
from labhil.analysis.verdicts import NOT_ASKED, VERDICTS, disagreement
from labhil.physics.terms import keyed
from labhil.report.absent import OfJoints, joints_in, of_joints, silences
from labhil.report.html.curve import curve_picture
from labhil.report.html.element import Content, Markup, joined, tag
from labhil.report.html.model import (
    bars,
    channel_named,
    intervals_picture,
    named,
    names,
    parameters_table,
    recordings_table,
    warning,
)
from labhil.report.html.page import Page, Section, present, section
from labhil.report.html.picture import Album
from labhil.report.html.quantity import NOTHING, chance, interval, multiple, p_value, percent, quantity
from labhil.report.html.table import bullets, facts, numbers, table, text, tiles, with_code

P_VALUES = {
    "bootstrap": "It was counted in a bootstrap",
    "tail_extrapolated": "It is extrapolated from the tail of a theoretical distribution, not counted: "
    "read its order of magnitude, not its digits",
}


def diagnosis_page(
    diagnosis: DiagnosisPart, foot: str, album: Album, pictures: Sequence[Markup] = ()
) -> Page:
    """The page of a diagnosis; ``pictures`` are those that need the data, and stand under the scores."""
    rig = ", ".join(dict.fromkeys(source.rig for source in diagnosis.recordings))
    return Page(
        kind=f"Diagnosis of a model and a recording · {rig}"
        if rig
        else "Diagnosis of a model and a recording",
        title=f"Diagnosis: {VERDICTS[diagnosis.verdict].rstrip('.')}",
        headline=VERDICTS[diagnosis.verdict],
        tone=diagnosis.verdict,
        lead=_lead(diagnosis),
        sections=present(
            section("What to do next", bullets(map(with_code, diagnosis.next_steps))),
            section("Faults of the data", *(tag("p", fault.statement) for fault in diagnosis.faults)),
            section("Sizes that gave way", *(tag("p", size.statement) for size in diagnosis.collapsed)),
            section("What is missing", *(_missing(item, diagnosis.rivals) for item in diagnosis.missing)),
            _changed(diagnosis),
            _location(diagnosis.location),
            _improvement(diagnosis.improvement, pictures),
            section(
                "The estimated curve",
                *(curve_picture(album, each) for each in (diagnosis.curve, *diagnosis.further_curves)),
            ),
            _final(diagnosis, album),
            _rivals(diagnosis.rivals),
            _excluded(diagnosis),
            _undecided(diagnosis),
            _method(diagnosis),
        ),
        foot=foot,
    )


def _lead(diagnosis: DiagnosisPart) -> tuple[Content, ...]:
    found = [keyed(item.term, item.joint) for item in diagnosis.missing]
    what = tag("p", "Found: ", names(found), ".", class_="lead") if found else None
    where = diagnosis.location
    statement = tag("p", where.statement, class_="lead") if where else None
    rest = diagnosis.remainder
    remains = tag("p", rest.statement, class_="lead") if rest else None
    return what, statement, remains, _figures(diagnosis)


def _figures(diagnosis: DiagnosisPart) -> Markup:
    better = diagnosis.improvement
    entries: list[tuple[str, Content, Content]] = [
        ("p that the baseline suffices", p_value(diagnosis.p_value), joined(_p_remark(diagnosis)))
        if diagnosis.asks_baseline
        else ("The baseline", NOTHING, NOT_ASKED)
    ]
    if better is not None:
        unit = better.unit
        entries += [
            ("RMSE before", quantity(better.rmse_before, unit), _over_floor(better.rmse_before, better)),
            ("RMSE after", quantity(better.rmse_after, unit), _over_floor(better.rmse_after, better)),
            ("R² after", percent(better.r2_after), f"{percent(better.r2_before)} before, {_judged(better)}"),
        ]
    return tiles(entries)


def _over_floor(rmse: float | None, better: Improvement) -> str:
    return f"{multiple(rmse, better.noise_floor)} the noise floor"


def _judged(better: Improvement) -> str:
    return "on the test recording" if better.data == "test" else "on held-out data"


def _p_remark(diagnosis: DiagnosisPart) -> list[Content]:
    method = (
        "extrapolated from the tail" if diagnosis.p_value_method == "tail_extrapolated" else "by bootstrap"
    )
    return [method if diagnosis.p_value_method in P_VALUES else diagnosis.p_value_method]


def _missing(item: MissingEffect, rivals: Sequence[Rival]) -> Markup:
    evidence = item.evidence
    told = facts(
        (
            ("ΔBIC, with against without", quantity(evidence.delta_bic)),
            ("Gain on held-out data", quantity(evidence.heldout_loglik_gain, "nats")),
            ("p that it gains nothing", p_value(evidence.p_value)),
        ),
        "row",
    )
    instead = [r for r in rivals if (r.instead_of, r.joint) == (item.term, item.joint)]
    return tag(
        "article",
        tag(
            "h3",
            keyed(item.term, item.joint),
            tag("span", "probability ", chance(item.probability), class_="remark"),
        ),
        tag("p", item.statement),
        tag("p", item.equation, class_="equation") if item.equation else None,
        parameters_table(item.parameters, f"Parameters of {keyed(item.term, item.joint)}"),
        told,
        _or_rather(instead),
        class_="card",
    )


def _or_rather(rivals: Sequence[Rival]) -> Markup | None:
    if not rivals:
        return None
    others = ", ".join(f"{keyed(r.term, r.joint)} ({chance(r.probability)})" for r in rivals)
    return tag("p", f"It might be, instead: {others}.")


def _changed(diagnosis: DiagnosisPart) -> Section | None:
    if not diagnosis.changed:
        return None
    rows = [
        (
            named(change.name, change.joint, change.recording),
            quantity(change.before, change.unit),
            quantity(change.after, change.unit),
            interval(change.ci99, change.unit),
            p_value(change.p_value),
        )
        for change in diagnosis.changed
    ]
    columns = (*text("Parameter"), *numbers("Before", "After", "99 % interval", "p"))
    return section("Parameters that have changed", table("Against the reference model", columns, rows))


def _location(where: Location | None) -> Section | None:
    if where is None:
        return None
    times = ", ".join(_time(span, where.times_in[i : i + 1]) for i, span in enumerate(where.times))
    told = facts(
        (
            ("Channel", tag("code", keyed(where.channel, where.joint))),
            ("It enters by", where.enters),
            *((("Times", times),) if times else ()),
        )
    )
    rows = [
        (
            tag("code", keyed(r.term, r.joint)),
            tag("code", r.coordinate),
            quantity(r.low, r.unit),
            quantity(r.high, r.unit),
            percent(r.share_of_excess),
        )
        for r in where.regimes
    ]
    columns = (*text("Effect", "Coordinate"), *numbers("From", "To", "Share of the excess"))
    regimes = table("Where each effect lives", columns, rows) if rows else None
    return section("Where the mismatch is", told, regimes)


def _time(span: Interval, recording: Sequence[int]) -> str:
    """A stretch of time, with the number of its recording where there are several."""
    return interval(span, "s") + "".join(f" of @{number}" for number in recording)


def _improvement(better: Improvement | None, pictures: Sequence[Markup]) -> Section | None:
    if better is None:
        return section("How much better the model predicts", *pictures)
    columns = (
        *text("Channel"),
        *numbers("RMSE before", "RMSE after", "Noise floor"),
        *text("Before, after, floor"),
        *numbers("R² before", "R² after"),
    )
    caption = "Before above after; the line is the noise floor, which a perfect model would reach"
    rows = [_channel(channel, better.metric) for channel in better.per_channel]
    for own in better.per_recording:
        rows += [_channel(channel, better.metric, own.recording) for channel in own.per_channel]
    return section(
        "How much better the model predicts",
        tag("p", _scored(better)),
        table(caption, columns, rows) if rows else None,
        *pictures,
    )


def _scored(better: Improvement) -> str:
    many = len(better.per_recording) > 1 and not better.parts
    if better.data == "test":
        data = "the test recordings" if many else "the test recording"
    else:
        data = "the held-out end of each recording" if many else "the held-out end of the recording"
    unseen = f"the parts of {data} that" if better.parts else f"{data}, which"
    if better.metric == "inverse_dynamics":
        return f"Scored by inverse dynamics on {unseen} the search never saw."
    return (
        f"Scored by simulating windows of {quantity(better.horizon, 's')} of {unseen} the search never saw."
    )


def _channel(channel: ChannelImprovement, metric: str, recording: int | None = None) -> list[Content]:
    return [
        channel_named(channel, metric, recording),
        quantity(channel.rmse_before, channel.unit),
        quantity(channel.rmse_after, channel.unit),
        quantity(channel.noise_floor, channel.unit),
        bars(channel.rmse_before, channel.rmse_after, channel.noise_floor),
        percent(channel.r2_before),
        percent(channel.r2_after),
    ]


def _final(diagnosis: DiagnosisPart, album: Album) -> Section | None:
    final, apart = diagnosis.final, disagreement(diagnosis.scale_factor)
    return section(
        "Final model",
        tag("p", "Its terms: ", names(final.terms), "."),
        tag("p", apart) if apart else None,
        parameters_table(diagnosis.judged_rows, "Parameters of the final model, fitted to the search data"),
        intervals_picture(album, diagnosis.judged_rows),
    )


def _rivals(rivals: Sequence[Rival]) -> Section | None:
    if not rivals:
        return None
    columns = (
        *text("Rival", "Instead of"),
        *numbers("Probability", "ΔBIC"),
        *text("Can be told apart", "What would tell them apart"),
    )
    rows = [
        (
            tag("code", keyed(rival.term, rival.joint)),
            tag("code", rival.instead_of),
            chance(rival.probability),
            quantity(rival.delta_bic, digits=3),
            "yes" if rival.distinguishable else "no",
            rival.experiment,
        )
        for rival in rivals
    ]
    return section("Rivals", table("What would explain the data about as well", columns, rows))


def _excluded(diagnosis: DiagnosisPart) -> Section | None:
    if not diagnosis.excluded:
        return None
    whole = [item for item in diagnosis.excluded if item.joint is None]
    columns = (*text("Effect"), *numbers("Largest that could hide", "Confidence"))
    rows = [
        (
            tag("code", keyed(item.term, None, item.recording)),
            quantity(item.largest_hidden, item.unit, digits=3),
            f"{100 * item.confidence:.4g}\N{NO-BREAK SPACE}%" if item.confidence is not None else None,
        )
        for item in whole
    ]
    caption = "Effects that are absent, or smaller than this in their main parameter"
    return section(
        "What is not there",
        table(caption, columns, rows) if rows else None,
        _excluded_of_joints(of_joints(diagnosis.excluded)),
    )


def _excluded_of_joints(limits: Sequence[OfJoints]) -> Markup | None:
    if not limits:
        return None
    joints = joints_in(limits)
    columns = (*text("Effect"), *numbers(*(f"Joint {joint}" for joint in joints)), *text("Unit"))
    rows = [
        (
            tag("code", row.term),
            *(quantity(row.largest.get(joint), digits=3) for joint in joints),
            row.unit if row.unit != "1" else None,
        )
        for row in limits
    ]
    return table("The same by joint, with 99 % confidence", columns, rows)


def _undecided(diagnosis: DiagnosisPart) -> Section | None:
    if not diagnosis.undecided:
        return None
    lines = [
        joined(
            (
                tag("code", silence.name),
                f": {silence.reason}",
                f"; it needs {', '.join(silence.needs)}" if silence.needs else None,
                ".",
            )
        )
        for silence in silences(diagnosis.undecided)
    ]
    return section("What these data cannot decide", bullets(lines))


def _method(diagnosis: DiagnosisPart) -> Section | None:
    parts: list[Content] = [recordings_table(diagnosis.recordings)]
    if diagnosis.p_value_method in P_VALUES:
        floor = f" A smaller one than {p_value(diagnosis.p_value_floor)} could not be counted."
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
        tag("p", f"The search took {quantity(diagnosis.seconds, 's', digits=3)}.", class_="quiet"),
    ]
    if not diagnosis.recordings:
        parts.insert(0, warning("The result names no recording that it comes from."))
    return section("Recordings and method", *parts)
