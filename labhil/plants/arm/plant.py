"""A simulated arm: planned motion in, signals of the controller out (needs MuJoCo)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from labhil.errors import UsageError
from labhil.plants.arm.effects import Overrides, resolve
from labhil.plants.arm.elastic import ElasticBody, Springs
from labhil.plants.arm.friction import Friction, JointMemory, ThermalModel, apply_friction
from labhil.plants.arm.links import JOINTS, UR5, Links
from labhil.plants.arm.rigid_body import Load, RigidBody
from labhil.plants.arm.sensors import Sensors
from labhil.plants.arm.servo import Motion, ServoState, track
from labhil.signals import FloatArray

SAMPLE_PERIOD = 0.008
SETTLING_TIME = 0.05
"""Time (s) of steady motion of the joints before the first row of a plan."""


@dataclass(frozen=True, slots=True)
class Truth:
    """True quantities at the time stamps, (n, 6) each; torques N·m on the drive's side of the gear.

    ``body`` is the torque of the rigid body (through the springs of elastic joints), ``friction`` that of the
    joints, ``torque`` the sum; ``current`` A.
    """

    q: FloatArray
    qd: FloatArray
    qdd: FloatArray
    body: FloatArray
    friction: FloatArray
    torque: FloatArray
    current: FloatArray
    temperature: FloatArray


@dataclass(frozen=True, slots=True)
class Trajectory:
    """Signals of the controller at the time stamps ``t`` (n,) s, (n, 6) each.

    Angles rad, currents A, moments N·m, temperatures °C, voltage (n,) V; and the true quantities.
    """

    t: FloatArray
    actual_q: FloatArray
    actual_qd: FloatArray
    actual_current: FloatArray
    target_q: FloatArray
    target_qd: FloatArray
    target_qdd: FloatArray
    target_current: FloatArray
    target_moment: FloatArray
    joint_temperatures: FloatArray
    actual_main_voltage: FloatArray
    truth: Truth

    def signals(self) -> dict[str, FloatArray]:
        """Return all signals by name, (n, 6) or (n,), without time stamps and truth."""
        names = (name for name in self.__dataclass_fields__ if name not in {"t", "truth"})
        return {name: getattr(self, name) for name in names}


class ArmPlant:
    """A simulated arm; it starts at rest with all angles zero.

    Args:
        parameters: Values by name, SI, that replace defaults: ``coulomb_friction.level`` of all joints (one
            number or six), ``coulomb_friction.level[2]`` of joint 2.
        terms: Names of the effects that it has.
        seed: Seed of the noise, and of the friction at rest.
        period: Time between samples, s.
        links: Its links.

    Raises:
        UnknownNameError: An effect or a parameter does not exist.
        UsageError: A value is out of range.
        MissingExtraError: The package ``mujoco`` is not installed.
    """

    def __init__(
        self,
        parameters: Overrides | None = None,
        terms: Iterable[str] = (),
        seed: int = 0,
        period: float = SAMPLE_PERIOD,
        links: Links = UR5,
    ) -> None:
        self.terms = tuple(terms)
        self.links = links
        self.period = period
        self._values = values = resolve(self.terms, parameters or {})
        if not 0.0 <= values.number("stamp_jitter") < 0.5 * period:
            raise UsageError(f"stamp_jitter must be less than half the sample period of {period:g} s")
        self._expected = RigidBody(links)
        self._body = RigidBody(links, Load.of(values.numbers))
        springs = Springs.of(values)
        self._elastic = ElasticBody(self._body, springs) if springs is not None else None
        self._friction = Friction.of(values)
        self._thermal_model = ThermalModel.of(values)
        noise, random = np.random.default_rng(seed).spawn(2)
        self._sensors = Sensors.of(values, noise)
        self._random = random
        self._bandwidth = values.number("servo_bandwidth")
        self._clock_offset = values.number("clock_offset.offset")
        self._temperature = values.per_joint("start_temperature").copy()
        self._recent: Motion
        self._clock: float
        self._servo: ServoState
        self._delayed_servo: ServoState
        self._memory: JointMemory
        self.place(np.zeros(JOINTS))

    @property
    def parameters(self) -> dict[str, float]:
        """All parameters by key: ``coulomb_friction.level[2]`` for joint 2."""
        return self._values.by_key()

    @property
    def temperature(self) -> FloatArray:
        """True temperatures of the joints (6,), °C."""
        return self._memory.temperature.copy()

    def place(self, q: FloatArray) -> None:
        """Set the arm at rest at angles (6,), rad, and its clock to 0; joints keep their temperatures."""
        zeros = np.zeros(JOINTS)
        self._start(np.array([0.0]), np.asarray(q, dtype=np.float64)[None], zeros[None], zeros[None])

    def step(self, q_ref: FloatArray, qd_ref: FloatArray, qdd_ref: FloatArray, dt: float) -> Trajectory:
        """Advance by dt (s) to planned angles, velocities and accelerations (6,), and sample then."""
        if not dt > 0.0:
            raise UsageError(f"dt must be a positive time in s, found {dt!r}")
        row = (np.asarray(x, dtype=np.float64)[None] for x in (q_ref, qd_ref, qdd_ref))
        now = self._recent.t[-1:] + dt
        is_recent = self._recent.t > now[0] - self._clock_offset - 2.0 * dt
        is_recent[-1] = True
        q, qd, qdd = (
            np.concatenate([past[is_recent], new])
            for past, new in zip((self._recent.q, self._recent.qd, self._recent.qdd), row, strict=True)
        )
        self._recent = Motion(np.concatenate([self._recent.t[is_recent], now]), q, qd, qdd)
        return self._simulate(self._recent, now)

    def follow(self, q: FloatArray, qd: FloatArray, qdd: FloatArray) -> Trajectory:
        """Follow a plan with one row (n, 6) per sample period; the arm starts in its first row.

        Samples deviate by up to ``stamp_jitter`` s from regular times; the time stamps contain that.

        Args:
            q: Angles, rad.
            qd: Velocities, rad/s.
            qdd: Accelerations, rad/s².

        Returns:
            One sample per row.

        Raises:
            UsageError: The plan has no rows, is not finite or has not six joints.
        """
        plan = [np.ascontiguousarray(x, dtype=np.float64) for x in (q, qd, qdd)]
        for name, rows in zip(("q", "qd", "qdd"), plan, strict=True):
            if (
                rows.ndim != 2
                or rows.shape != (len(plan[0]), JOINTS)
                or not len(rows)
                or not np.isfinite(rows).all()
            ):
                raise UsageError(
                    f"{name} of a plan must be finite numbers of shape (n, {JOINTS}), found {rows.shape}"
                )
        t = self.period * np.arange(len(plan[0]), dtype=np.float64)
        planned = self._start(t, *plan)
        jitter = self._values.number("stamp_jitter")
        stamps = t + jitter * self._random.uniform(-1.0, 1.0, len(t)) if jitter > 0.0 else t
        stamps[0], stamps[-1] = t[0], t[-1]
        return self._simulate(planned, stamps)

    def _start(self, t: FloatArray, q: FloatArray, qd: FloatArray, qdd: FloatArray) -> Motion:
        """Set the arm to the first row of a plan, without transients; return the plan."""
        planned = Motion(t, q, qd, qdd)
        self._recent = planned
        self._clock = float(t[0])
        self._servo = ServoState.steady(planned.qdd[0], self._bandwidth)
        first = planned.at(t[:1] - self._clock_offset)
        self._delayed_servo = ServoState.steady(first.qdd[0], self._bandwidth)
        begin = track(first, np.zeros(1), self._bandwidth, self._delayed_servo)
        if self._elastic is not None:
            self._elastic.settle(begin.q[0], begin.qd[0], begin.qdd[0])
        self._settle_friction(begin)
        return planned

    def _settle_friction(self, begin: Motion) -> None:
        """Let the joints arrive at the first row of a motion at constant velocity."""
        sticking = self._random.uniform(-1.0, 1.0, JOINTS)
        bent = sticking * self._friction.coulomb / np.maximum(self._friction.stiffness, 1.0)
        self._memory = JointMemory(
            begin.q[0] - SETTLING_TIME * begin.qd[0],
            begin.qd[0].copy(),
            sticking,
            bent,
            self._temperature.copy(),
        )
        load = self._body_torque(begin, np.zeros(1))
        self._apply_friction(begin, np.array([SETTLING_TIME]), load, np.zeros_like(load))
        self._memory.temperature[:] = self._temperature

    def _simulate(self, plan: Motion, stamps: FloatArray) -> Trajectory:
        """Advance to the time stamps (n,), and sample there."""
        h = np.diff(stamps, prepend=self._clock)
        self._clock = float(stamps[-1])
        target = plan.at(stamps)
        actual = track(target, h, self._bandwidth, self._servo)
        delayed = actual
        if self._clock_offset > 0.0:
            delayed = track(plan.at(stamps - self._clock_offset), h, self._bandwidth, self._delayed_servo)
        body = self._body_torque(delayed, h)
        other_torque = self._other_torque(delayed)
        friction, temperature = self._apply_friction(delayed, h, body, other_torque)
        self._temperature = self._memory.temperature.copy()
        torque = body + friction + other_torque
        current = torque / self._thermal_model.torque_constant
        truth = Truth(actual.q, actual.qd, actual.qdd, body, friction, torque, current, temperature)
        return self._sample(target, truth)

    def _body_torque(self, motion: Motion, h: FloatArray) -> FloatArray:
        """Return the torques (n, 6) N·m of links, payload and cable under a motion of the drives."""
        if self._elastic is not None:
            return self._elastic.torques(motion, h)
        return self._body.torques(motion.q, motion.qd, motion.qdd)

    def _other_torque(self, motion: Motion) -> FloatArray:
        """Return the torques (n, 6) N·m of neither links nor friction."""
        per_joint = self._values.per_joint
        phase = per_joint("torque_ripple.order") * motion.q + per_joint("torque_ripple.phase")
        return np.asarray(
            per_joint("torque_ripple.amplitude") * np.sin(phase)
            + per_joint("added_inertia.inertia") * motion.qdd
            + per_joint("constant_force.force")
        )

    def _apply_friction(
        self, motion: Motion, h: FloatArray, load: FloatArray, other_torque: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return friction N·m and temperatures °C of a motion, (n, 6) each."""
        friction, temperature = np.empty_like(load), np.empty_like(load)
        apply_friction(
            motion.q, motion.qd, h, load, other_torque, self._memory, self._friction, self._thermal_model,
            friction, temperature,
        )  # fmt: skip
        return friction, temperature

    def _sample(self, target: Motion, truth: Truth) -> Trajectory:
        """Measure the signals of the controller, and add its plan and its predictions."""
        constant = self._thermal_model.torque_constant
        moment = self._expected.torques(target.q, target.qd, target.qdd)
        power = truth.torque * truth.qd + self._thermal_model.resistance * truth.current**2
        return Trajectory(
            t=target.t,
            actual_q=self._sensors.angles(truth.q),
            actual_qd=self._sensors.velocities(truth.qd),
            actual_current=self._sensors.currents(truth.current),
            target_q=target.q,
            target_qd=target.qd,
            target_qdd=target.qdd,
            target_current=moment / constant,
            target_moment=moment,
            joint_temperatures=self._sensors.temperatures(truth.temperature),
            actual_main_voltage=self._sensors.voltage(power.sum(axis=1)),
            truth=truth,
        )
