"""A simulated arm in real time: one sample takes some tens of µs.

It has the effects, friction, heating, sensors and servo of :class:`~labhil.plants.arm.plant.ArmPlant`, with
the rigid body by recursion instead of a physics engine.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from labhil.compiled import compiled
from labhil.plants.arm.effects import Overrides, resolve
from labhil.plants.arm.elastic import ElasticBody, Springs
from labhil.plants.arm.friction import Friction, JointMemory, ThermalModel, apply_friction
from labhil.plants.arm.links import JOINTS, UR5, Links, Vector
from labhil.plants.arm.newton_euler import LinkArrays, RecursiveBody, recursion
from labhil.plants.arm.rigid_body import Load
from labhil.plants.arm.sensors import Sensors
from labhil.plants.arm.servo import Motion, ServoState, follow_plan, track
from labhil.signals import FloatArray

ZERO_TIME = np.zeros(1)


class OtherTorques(NamedTuple):
    """Torques beside links and friction, (6,) each: ripple, inertia of the drives kg·m², constant N·m."""

    amplitude: FloatArray
    order: FloatArray
    phase: FloatArray
    inertia: FloatArray
    force: FloatArray


class TrueState(NamedTuple):
    """True state, (6,) each: rad, rad/s and N·m."""

    q: FloatArray
    qd: FloatArray
    body: FloatArray
    expected: FloatArray
    friction: FloatArray
    torque: FloatArray


class Setpoint(NamedTuple):
    """Setpoint of the controller: rad, rad/s, rad/s², (6,) each."""

    q: FloatArray
    qd: FloatArray
    qdd: FloatArray


class Sample(NamedTuple):
    """Readings of an arm's sensors, (6,) each: rad, rad/s, A, °C; the supply's voltage, V.

    ``target_current`` A and ``target_moment`` N·m are those that the controller's own model predicts;
    ``friction`` (6,) N·m is the true one, which is not measured.
    """

    q: FloatArray
    qd: FloatArray
    current: FloatArray
    temperature: FloatArray
    voltage: float
    target_current: FloatArray
    target_moment: FloatArray
    friction: FloatArray


class LiveArm:
    """A simulated arm, sample by sample; arguments and errors as for ``ArmPlant``.

    ``hidden_cable`` is refused (it needs the physics engine); ``stamp_jitter`` has no effect.
    """

    def __init__(
        self,
        parameters: Overrides | None = None,
        terms: Iterable[str] = (),
        seed: int = 0,
        links: Links = UR5,
    ) -> None:
        self.links = links
        self._values = values = resolve(tuple(terms), parameters or {})
        self._expected = RecursiveBody(links)
        self._body = RecursiveBody(links, Load.of(values.numbers))
        springs = Springs.of(values)
        self._elastic = ElasticBody(self._body, springs) if springs is not None else None
        self._friction, self._thermal_model = Friction.of(values), ThermalModel.of(values)
        noise, random = np.random.default_rng(seed).spawn(2)
        self._sensors, self._random = Sensors.of(values, noise), random
        self._bandwidth = values.number("servo_bandwidth")
        self._clock_offset = values.number("clock_offset.offset")
        per_joint = values.per_joint
        self._other_torques = OtherTorques(
            per_joint("torque_ripple.amplitude"),
            per_joint("torque_ripple.order"),
            per_joint("torque_ripple.phase"),
            per_joint("added_inertia.inertia"),
            per_joint("constant_force.force"),
        )
        self._state = TrueState(*(np.zeros(JOINTS) for _ in TrueState._fields))
        self._temperature = values.per_joint("start_temperature").copy()
        self._h = np.zeros(1)
        self.place(np.zeros(JOINTS))

    @property
    def parameters(self) -> dict[str, float]:
        """All parameters by key: ``coulomb_friction.level[2]`` for joint 2."""
        return self._values.by_key()

    @property
    def torque_constant(self) -> FloatArray:
        """N·m/A at the joints (6,)."""
        return self._thermal_model.torque_constant

    def place(self, q: FloatArray) -> None:
        """Set the arm at rest at angles (6,), rad; joints keep their temperatures."""
        zeros = np.zeros(JOINTS)
        self._clock = 0.0
        self._past = deque([(0.0, Setpoint(np.array(q, dtype=np.float64), zeros, zeros))])
        self._servo = ServoState.steady(zeros, self._bandwidth)
        self._delayed_servo = ServoState.steady(zeros, self._bandwidth)
        if self._elastic is not None:
            self._elastic.settle(np.array(q, dtype=np.float64), zeros, zeros)
        sticking = self._random.uniform(-1.0, 1.0, JOINTS)
        bent = sticking * self._friction.coulomb / np.maximum(self._friction.stiffness, 1.0)
        self._memory = JointMemory(
            np.array(q, dtype=np.float64), zeros.copy(), sticking, bent, self._temperature.copy()
        )

    def set_expected_load(self, mass: float, centre: Vector, gravity: Vector) -> None:
        """Set payload (kg, m) and gravity (m/s²) of the controller's model."""
        self._expected = RecursiveBody(self.links)
        self._expected.table.add_point_mass(mass, centre)
        self._expected.table.gravity[:] = gravity

    def expected(self) -> RecursiveBody:
        """Return the controller's own model of the arm."""
        return self._expected

    def step(self, plan: Setpoint, h: float) -> Sample:
        """Advance by h (s) to a setpoint, and sample then."""
        self._clock += h
        self._h[0] = h
        delayed = plan
        if self._clock_offset > 0.0:
            self._past.append((self._clock, plan))
            delayed = self._delayed_setpoint()
        state = self._state
        if self._elastic is not None:
            motion = track(_motion(delayed), self._h, self._bandwidth, _copy_state(self._delayed_servo))
            state.body[:] = self._elastic.torques(motion, self._h)[0]
        advance(
            plan, delayed, self._h, self._bandwidth, self._servo, self._delayed_servo, self._elastic is None,
            self._body.table, self._expected.table, self._memory, self._friction, self._thermal_model,
            self._other_torques, state,
        )  # fmt: skip
        self._temperature = self._memory.temperature
        return self._sample()

    def _delayed_setpoint(self) -> Setpoint:
        """Return the setpoint ``clock_offset`` earlier, linear between ticks."""
        wanted, past = self._clock - self._clock_offset, self._past
        while len(past) > 2 and past[1][0] <= wanted:
            past.popleft()
        (begin, first), (end, last) = past[0], past[1]
        share = min(max((wanted - begin) / (end - begin), 0.0), 1.0)
        return Setpoint(*(a + share * (b - a) for a, b in zip(first, last, strict=True)))

    def _sample(self) -> Sample:
        """Measure; the arrays are new ones."""
        sensors, constant, state = self._sensors, self._thermal_model.torque_constant, self._state
        current = state.torque / constant
        power = state.torque * state.qd + self._thermal_model.resistance * current * current
        return Sample(
            q=sensors.angles(state.q),
            qd=sensors.velocities(state.qd),
            current=sensors.currents(current[None])[0],
            temperature=sensors.temperatures(self._memory.temperature),
            voltage=float(sensors.voltage(power.sum(keepdims=True))[0]),
            target_current=state.expected / constant,
            target_moment=state.expected.copy(),
            friction=state.friction.copy(),
        )


def _motion(moment: Setpoint) -> Motion:
    return Motion(ZERO_TIME, moment.q[None], moment.qd[None], moment.qdd[None])


def _copy_state(servo: ServoState) -> ServoState:
    return ServoState(servo.error.copy(), servo.rate.copy(), servo.planned.copy())


@compiled
def advance(
    plan: Setpoint,
    delayed: Setpoint,
    h: FloatArray,
    bandwidth: float,
    servo: ServoState,
    delayed_servo: ServoState,
    rigid: bool,
    body: LinkArrays,
    expected: LinkArrays,
    memory: JointMemory,
    friction: Friction,
    thermal_model: ThermalModel,
    other_torques: OtherTorques,
    state: TrueState,
) -> None:
    """Advance the arm by one tick, in place; ``state.body`` is an input where the joints are not rigid."""
    shape = (1, 6)
    q, qd, qdd = np.empty(shape), np.empty(shape), np.empty(shape)
    follow_plan(as_row(plan.q), as_row(plan.qd), as_row(plan.qdd), h, bandwidth, servo, q, qd, qdd)
    state.q[:], state.qd[:] = q[0], qd[0]
    follow_plan(
        as_row(delayed.q), as_row(delayed.qd), as_row(delayed.qdd), h, bandwidth, delayed_servo, q, qd, qdd
    )
    if rigid:
        recursion(body, q[0], qd[0], qdd[0], state.body)
    recursion(expected, plan.q, plan.qd, plan.qdd, state.expected)
    other_torque, friction_torque, temperatures = np.empty(shape), np.empty(shape), np.empty(shape)
    for j in range(6):
        other_torque[0, j] = (
            other_torques.amplitude[j] * np.sin(other_torques.order[j] * q[0, j] + other_torques.phase[j])
            + other_torques.inertia[j] * qdd[0, j]
            + other_torques.force[j]
        )
    apply_friction(
        q,
        qd,
        h,
        as_row(state.body),
        other_torque,
        memory,
        friction,
        thermal_model,
        friction_torque,
        temperatures,
    )
    for j in range(6):
        state.friction[j] = friction_torque[0, j]
        state.torque[j] = state.body[j] + friction_torque[0, j] + other_torque[0, j]


@compiled
def as_row(values: FloatArray) -> FloatArray:
    """Return six values as a row (1, 6)."""
    return values.copy().reshape((1, 6))
