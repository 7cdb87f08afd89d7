"""The next steps after a diagnosis, a fit or a verification, by its verdict."""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from labhil.analysis.rig_option import rig_option
from labhil.physics.terms import enumerated, keyed, listed
from labhil.simulators.names import NO_PORT

if TYPE_CHECKING:
    from labhil.analysis.schema import DiagnosisPart, FitPart, MissingEffect, Source, VerificationPart

FORCE_CURVE = "unmodelled_force"
"""The name of an effect that has a curve and no law."""

Steps = Iterator[str]


def next_steps(diagnosis: DiagnosisPart) -> tuple[str, ...]:
    """Return the next steps, the most useful first: a sentence or two each."""
    return tuple(_STEPS[diagnosis.verdict](diagnosis))


def steps_after_fit(fit: FitPart) -> tuple[str, ...]:
    """Return the next steps after a fit, the most useful first: a sentence or two each."""
    return tuple(_steps_after_fit(fit))


def _steps_after_fit(fit: FitPart) -> Steps:
    recording, rig = _path_of(fit.recordings), _rig_of(fit.recordings)
    terms = ",".join(listed(fit.terms)) or "none"
    if not fit.converged:
        yield "The search stopped before it had settled: give it more time, the values may change."
    if fit.verdict not in (None, "explained"):
        yield (
            "The model leaves more than noise: "
            f"`labhil diagnose {recording}{rig} --baseline {terms}` looks for what is missing."
        )
    elif fit.by_window and fit.window is not None and fit.window < fit.by_window[-1].window:
        yield (
            "The plant itself is disturbed, or physics is missing: "
            f"`labhil diagnose {recording}{rig} --baseline {terms}` tests which."
        )
    if fit.identifiability.would_help:
        yield f"It would help to know or to record: {', '.join(fit.identifiability.would_help)}."
    if fit.verdict in (None, "explained"):
        yield (
            f"Hold the next recording against it: `labhil verify NEW.mcap{rig} --model FIT.json`."
            if any(source.role == "test" for source in fit.recordings)
            else "Judge it on a recording of its own, with other amplitudes and frequencies: "
            f"`labhil fit {recording}{rig} --terms {terms} --test NEW.mcap`."
        )


def steps_after_verification(verification: VerificationPart) -> tuple[str, ...]:
    """Return the next steps after a verification, the most useful first: a sentence or two each."""
    return tuple(_steps_after_verification(verification))


def _steps_after_verification(verification: VerificationPart) -> Steps:
    recording, rig = _path_of(verification.recordings), _rig_of(verification.recordings)
    if verification.faults:
        yield "Mend the faults of the data and record again: they may be all that is wrong."
    diagnosis = f"`labhil diagnose {recording}{rig} --model {verification.model}`"
    terms = ",".join(listed(verification.terms)) or "none"
    changed = [keyed(row.name, row.joint) for row in verification.parameters if row.changed]
    if changed:
        yield (
            f"Look for what changed {enumerated(changed)} of the rig since the model was accepted; "
            f"`labhil fit {recording}{rig} --terms {terms}` takes the "
            "values anew."
        )
    if not verification.consistent:
        yield f"{diagnosis} names what the model lacks, or which of its values changed."
    elif verification.adequacy != "explained":
        yield f"The recording is no worse than those before it, but more than noise remains: {diagnosis}."
    else:
        command = f"`labhil verify NEW.mcap{rig} --model {verification.model}`"
        yield f"Hold the next recording against it: {command}."


def _path(diagnosis: DiagnosisPart) -> str:
    return _path_of(diagnosis.recordings)


def _path_of(sources: Sequence[Source]) -> str:
    """Path of the first recording; "REC.mcap" for one of arrays that was never saved."""
    path = sources[0].path if sources else ""
    return shlex.quote(path) if Path(path).suffix else "REC.mcap"


def _rig(diagnosis: DiagnosisPart) -> str:
    return _rig_of(diagnosis.recordings)


def _rig_of(sources: Sequence[Source]) -> str:
    """The option that gives the rig file again, where the recordings' own was not used."""
    return rig_option(sources[0]) if sources else ""


def _baseline(diagnosis: DiagnosisPart) -> str:
    return ",".join(listed(diagnosis.baseline.terms)) or "none"


def _early_end_step(diagnosis: DiagnosisPart) -> Steps:
    if not diagnosis.complete:
        yield "The search was ended early: let it run to its end, the answer may change."


def _steps_after_missing_physics(diagnosis: DiagnosisPart) -> Steps:
    yield from _early_end_step(diagnosis)
    for rival in diagnosis.rivals:
        yield (
            f"To tell {keyed(rival.term, rival.joint)} from {rival.instead_of}, {rival.experiment}, record"
            " that, and diagnose both recordings together."
        )
    named_effects = [item for item in diagnosis.missing if item.term != FORCE_CURVE]
    quantified = [item for item in named_effects if _is_quantified(item)]
    if quantified:
        yield (
            f"Put {_effect_names(quantified)} into your simulation, with the equations and values given here."
            f"{_patch_sentence(diagnosis, 'them')}"
        )
    if len(quantified) < len(named_effects):
        unquantified = _effect_names(item for item in named_effects if not _is_quantified(item))
        yield (
            f"Of {unquantified} these data know the kind and not the size: state in `[known]` what you know"
            " of the rig, or record a motion that shows it."
        )
    if len(named_effects) < len(diagnosis.missing):
        yield from _channel_step(diagnosis)
        yield (
            "No law that could be tried has the shape of the curve: use it as a table, or write the law that"
            " you think it is (docs/how-to/add-a-law.md) and diagnose again."
        )
    if diagnosis.remainder is not None and not diagnosis.remainder.is_noise:
        yield from _simulator_step(diagnosis)
        yield (
            f"More than noise remains: `labhil fit {_path(diagnosis)} --terms"
            f" {','.join(listed(diagnosis.final.terms))}{_rig(diagnosis)}` shows where in time."
        )
    yield from _validation_step(diagnosis)


def _is_quantified(item: MissingEffect) -> bool:
    return not item.parameters or any(row.identifiable for row in item.parameters)


def _patch_sentence(diagnosis: DiagnosisPart, what: str) -> str:
    """That a file can be repaired, where the diagnosed model is not one of labhil's own."""
    from labhil.physics.rigs import MODELS

    own = any(recording.rig in MODELS for recording in diagnosis.recordings)
    files = "a MuJoCo, URDF or Python file, or beside an FMU"
    return "" if own else f" `labhil patch` writes {what} into {files}."


def _channel_step(diagnosis: DiagnosisPart) -> Steps:
    """The channels without which some laws could not be tried."""
    channels = _lacking_channels(diagnosis)
    if channels:
        laws = sorted({keyed(item.term, item.joint) for item in diagnosis.undecided if item.needs})
        yield f"Record {enumerated(channels)}, too: {enumerated(laws)} could not be tried without."


def _lacking_channels(diagnosis: DiagnosisPart) -> list[str]:
    return sorted({need for item in diagnosis.undecided for need in item.needs})


def _simulator_step(diagnosis: DiagnosisPart) -> Steps:
    if any(item.reason == NO_PORT for item in diagnosis.undecided):
        yield (
            "What acts inside the mechanism, two columns do not show: give the simulator itself (a Python"
            " function, a MuJoCo or URDF file, an FMU), and forces are searched, too."
        )


def _validation_step(diagnosis: DiagnosisPart) -> Steps:
    improvement = diagnosis.improvement
    command = f"`labhil verify NEW.mcap --model DIAGNOSIS.json{_rig(diagnosis)}`"
    if improvement is not None and improvement.data == "test":
        yield f"Hold the next recording against it: {command}."
    else:
        yield f"Judge it on a recording of its own, with other amplitudes and frequencies: {command}."


def _steps_after_parameter_change(diagnosis: DiagnosisPart) -> Steps:
    yield from _early_end_step(diagnosis)
    changed = [keyed(item.name, item.joint, item.recording) for item in diagnosis.changed]
    yield (
        f"Take the new value of {enumerated(changed)} into your simulation, or find out what changed at the"
        f" rig.{_patch_sentence(diagnosis, 'it')}"
    )
    yield from _validation_step(diagnosis)


def _steps_after_no_mismatch(diagnosis: DiagnosisPart) -> Steps:
    yield (
        "Use the model where the recording went. Other amplitudes, speeds or frequencies may show what is"
        " only excluded up to a size here."
    )
    yield from _validation_step(diagnosis)


def _steps_after_unexplained_mismatch(diagnosis: DiagnosisPart) -> Steps:
    yield from _early_end_step(diagnosis)
    yield from _simulator_step(diagnosis)
    yield from _channel_step(diagnosis)
    if diagnosis.location is not None and diagnosis.location.times:
        yield "Look at the rig and its cables at the times that are named: what happened there?"
    yield (
        "Record what else may drive the rig (a load, a temperature, a supply) as a further channel, or"
        " repeat the run: what comes back at the same place is physics, what does not is a disturbance."
    )
    command = f"`labhil linear {_path(diagnosis)}{_rig(diagnosis)}`"
    yield f"{command} tells how well any model without physics predicts these data."


def _steps_after_data_fault(diagnosis: DiagnosisPart) -> Steps:
    yield (
        "Mend the data first, as each fault says, or take a good stretch with `--span FROM TO`; nothing was"
        " searched."
    )
    yield f"Then: `labhil diagnose {_path(diagnosis)} --baseline {_baseline(diagnosis)}{_rig(diagnosis)}`."


def _steps_after_not_decidable(diagnosis: DiagnosisPart) -> Steps:
    yield from _early_end_step(diagnosis)
    needs = _lacking_channels(diagnosis)
    if needs:
        yield f"Record with {enumerated(needs)}."
    elif diagnosis.complete:
        yield (
            "Record longer, and move the rig more: larger amplitudes, both directions, several speeds."
            " `labhil new` writes such an experiment."
        )


def _effect_names(effects: Iterable[MissingEffect]) -> str:
    return enumerated([keyed(item.term, item.joint) for item in effects])


_STEPS = {
    "missing_physics": _steps_after_missing_physics,
    "parameter_change": _steps_after_parameter_change,
    "no_mismatch": _steps_after_no_mismatch,
    "unexplained_mismatch": _steps_after_unexplained_mismatch,
    "data_fault": _steps_after_data_fault,
    "not_decidable": _steps_after_not_decidable,
}
