"""The benches that trials are recorded on, by kind of rig."""

from __future__ import annotations

from collections.abc import Mapping

from labhil.campaign.trials.arm import UR5
from labhil.campaign.trials.one_input_rigs import AXIS, BALL_BEAM, DC_MOTOR, SOLENOID
from labhil.campaign.trials.secret import Bench
from labhil.errors import UnknownNameError

BENCHES: Mapping[str, Bench] = {
    **{bench.kind: bench for bench in (BALL_BEAM, DC_MOTOR, AXIS, SOLENOID)},
    UR5.kind: UR5,
}


def bench_of(kind: str, seconds: float | None = None) -> Bench:
    """Return the bench of a kind of rig; ``seconds`` replaces the duration of its recordings.

    Raises:
        UnknownNameError: there is no such bench.
    """
    if kind not in BENCHES:
        raise UnknownNameError("rig with trials", kind, BENCHES)
    return BENCHES[kind] if seconds is None else BENCHES[kind].with_duration(seconds)
