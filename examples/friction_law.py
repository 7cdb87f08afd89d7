"""A friction law of your own: stated once, and named by a diagnosis of a rig that hides it."""

import numpy as np

import labhil as lh

lh.add_law(
    lh.FrictionLaw(
        "sqrt_friction",
        np.sqrt,
        unit="{force}·√s/√{length}",
        statement="friction that grows with the square root of speed",
        equation="F = c·√|v|·sgn v",
        source="a lubricated contact, by this script",
    )
)

dt, n, substeps = 5e-3, 3000, 200
t = dt * np.arange(n)
force = np.repeat(np.random.default_rng(1).uniform(-80.0, 80.0, n // 75), 75)
position = np.zeros(n)
x = v = 0.0
for k in range(n):
    position[k] = x
    for _ in range(substeps):
        friction = 60.0 * v + 25.0 * np.sqrt(abs(v)) * np.sign(v)
        v += dt / substeps * (force[k] - friction - 200.0 * x) / 20.0
        x += dt / substeps * v
position += np.random.default_rng(2).normal(0.0, 1e-4, n)

rec = lh.recording(
    t, {"drive_force": force}, {"position": position}, rig=lh.model("axis", known={"moving_mass": 20.0})
)
diagnosis = lh.diagnose(rec, baseline=["viscous_friction", "spring_force"])
print(diagnosis)
diagnosis.plot().figure.savefig("friction_law.png")
for effect in diagnosis.missing:
    print(effect.term, "put in: sqrt_friction, coefficient 25")
