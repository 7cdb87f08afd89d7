from __future__ import annotations

import numpy as np
import pytest

from labhil.errors import CommandRefusedError
from labhil.kinds import BALL_BEAM
from labhil.rig_sections import Limit
from labhil.service.lease import DURATION, Lease
from labhil.service.limits import CommandLimits, SampleLimits
from labhil.service.messages import HostConfig, Setpoint
from labhil.signals import Batch, Stream

SERVO, POSITION = BALL_BEAM.inputs[0], BALL_BEAM.outputs[0]
STREAM = Stream("state", (POSITION, SERVO), 100.0)
LIMITS = {"servo_angle": Limit(min=-1.0, max=1.0, rate=5.0), "ball_position": Limit(min=-0.2, max=0.2)}


def batch(*rows: tuple[float, float]) -> Batch:
    return Batch.of([(i, i, i, row) for i, row in enumerate(rows)], 2)


def test_a_streamed_value_is_clipped_to_range_and_rate() -> None:
    limits = CommandLimits((SERVO,), LIMITS, {})
    assert limits.clip("servo_angle", 3.0, previous=0.99, elapsed=1.0) == 1.0
    assert limits.clip("servo_angle", -1.0, previous=0.0, elapsed=0.01) == pytest.approx(-0.05)
    assert limits.clip("servo_angle", 0.03, previous=0.0, elapsed=0.01) == 0.03
    assert limits.clip("servo_angle", 0.5, previous=0.2, elapsed=0.0) == 0.2


def test_without_limits_nothing_is_clipped_but_numbers_are_asked_for() -> None:
    limits = CommandLimits((SERVO,), {}, {})
    assert limits.clip("servo_angle", 30.0, previous=0.0, elapsed=0.01) == 30.0
    with pytest.raises(CommandRefusedError, match="finite"):
        limits.refuse_unusable({"servo_angle": float("nan")})
    with pytest.raises(CommandRefusedError, match="did you mean 'servo_angle'"):
        limits.refuse_unusable({"servo_angel": 0.1})


def test_samples_are_looked_at_one_by_one() -> None:
    limits = SampleLimits(STREAM, (SERVO,), LIMITS)
    assert limits.violation(batch((0.2, 1.0), (-0.2, -1.0))) is None
    told = limits.violation(batch((0.0, 0.0), (0.21, 0.0)))
    assert told is not None
    assert "ball_position = 0.21 left its limits, -0.2 to 0.2 (sample 1)" in told
    assert limits.violation(batch((np.nan, 0.0))) is not None


def test_a_commanded_signal_may_pass_its_limit_by_a_rounding() -> None:
    limits = SampleLimits(STREAM, (SERVO,), LIMITS)
    assert limits.violation(batch((0.0, 1.003))) is None
    assert limits.violation(batch((0.0, 1.03))) is not None


def test_a_signal_without_limits_may_be_anything() -> None:
    assert SampleLimits(STREAM, (SERVO,), {}).violation(batch((np.nan, np.inf))) is None


def test_a_lease_runs_out_when_nothing_is_heard() -> None:
    lease = Lease()
    token = lease.take("first", now=0.0)
    lease.renew(token, now=DURATION * 0.9)
    assert lease.is_held(now=DURATION * 1.8)
    assert not lease.is_held(now=DURATION * 2)
    with pytest.raises(CommandRefusedError, match="ran out"):
        lease.renew(token, now=DURATION * 2)
    assert lease.take("second", now=DURATION * 2) != token


def test_a_hosts_configuration_survives_its_way() -> None:
    config = HostConfig("bench", "ball_beam", "/dev/ttyACM0", LIMITS, "tcp/127.0.0.1:1", 0.5)
    assert HostConfig.from_line(config.to_line()) == config


@pytest.mark.parametrize("payload", [b"", b"[]", b"{}", b'{"token": "a", "t_ns": 1, "values": [1]}', b"\xff"])
def test_a_setpoint_that_is_none_is_refused(payload: bytes) -> None:
    with pytest.raises(CommandRefusedError, match="a setpoint is"):
        Setpoint.from_bytes(payload)


def test_the_range_of_the_device_narrows_the_limits() -> None:
    limits = CommandLimits((SERVO,), {"servo_angle": Limit(max=2.0)}, {"servo_angle": (-1.0, 3.0)})
    assert limits.clip("servo_angle", 9.0, None, 0.0) == 2.0
    assert limits.clip("servo_angle", -9.0, None, 0.0) == -1.0
