"""A simulator of your own: a pendulum in Python whose bench has dry friction that the simulator lacks."""

import math

import numpy as np

import labhil as lh


def swing(t, x, u, p):
    """Rates of angle and rate."""
    return x.rate, (u.torque - p.gravity_torque * math.sin(x.angle)) / p.inertia


pendulum = lh.simulator(
    swing,
    name="pendulum",
    states={"angle": "rad", "rate": "rad/s"},
    inputs={"torque": "N·m"},
    parameters={"inertia": lh.Quantity(0.02, "kg·m²"), "gravity_torque": lh.Quantity(0.5, "N·m")},
)


def bench(t, torque):
    """What a bench with dry friction would measure: small steps, at rest while the friction holds."""
    inertia, gravity, drag, dry, finer = 0.025, 0.45, 0.012, 0.05, 50
    angle, rate, step, angles = 0.2, 0.0, (t[1] - t[0]) / finer, []
    for now in torque:
        angles.append(angle)
        for _ in range(finer):
            pull = now - gravity * math.sin(angle)
            if rate == 0.0 and abs(pull) <= dry:
                continue
            side = math.copysign(1.0, rate or pull)
            after = rate + step * (pull - drag * rate - side * dry) / inertia
            rate = 0.0 if after * rate < 0.0 else after
            angle += step * rate
    return np.array(angles)


random = np.random.default_rng(1)
t = np.arange(0.0, 20.0, 0.01)
torque = 0.12 * np.sin(2 * np.pi * 0.3 * t) + 0.12 * np.sin(2 * np.pi * 0.71 * t + 1) + 0.1 * np.sin(8 * t)
angle = bench(t, torque) + 1e-3 * random.standard_normal(len(t))

recording = lh.recording(t, {"torque": torque}, {"angle": angle}, rig=pendulum)
print(len(lh.model(pendulum).terms), "effects are offered to the pendulum")
diagnosis = lh.diagnose(recording)
print(diagnosis)
print("missing:", [effect.term for effect in diagnosis.missing])
