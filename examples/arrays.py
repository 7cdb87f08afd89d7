"""Data of your own, as numpy arrays: the step responses of a DC motor, made here by a few lines of Euler."""

import numpy as np

import labhil as lh

dt, n, substeps = 1e-3, 8000, 10
t = dt * np.arange(n)
voltage = np.repeat([3.0, -2.0, 6.0, -5.0, 1.5, 0.0, -6.0, 4.0], n // 8)
inertia, torque_constant, resistance, inductance = 2e-4, 0.05, 2.0, 5e-3  # SI
speed, current = np.zeros(n), np.zeros(n)
w = i = 0.0
for k in range(n):
    speed[k], current[k] = w, i
    for _ in range(substeps):
        friction = 1e-4 * w + 4e-3 * np.tanh(w / 0.1)
        w, i = (
            w + dt / substeps * (torque_constant * i - friction) / inertia,
            i + dt / substeps * (voltage[k] - resistance * i - torque_constant * w) / inductance,
        )
noise = np.random.default_rng(1)
speed += noise.normal(0.0, 0.05, n)
current += noise.normal(0.0, 0.005, n)

rec = lh.recording(t, {"voltage": voltage}, {"speed": speed, "current": current}, rig="dc_motor")
print(rec)
fit = lh.fit(rec, terms=["viscous_friction", "coulomb_friction"], estimator="nlse")
print(fit)
for name, true in (("torque_constant", torque_constant), ("inertia", inertia), ("inductance", inductance)):
    print(f"{fit.parameters[name]}, put in: {true:g}")
