"""A simulated DC motor on its real wire: commands and samples at hand, then a scripted run and a fit of it.

With a bench in place of the twin the address is that of its port, such as "/dev/ttyACM0".
"""

import tempfile

import labhil as lh

with lh.connect("dc_motor", "twin") as bench:
    print(f"{bench.spec.description}: {', '.join(bench.signals)} at {bench.rate:g} Hz")
    bench.command(voltage=3.0, hold=0.5)
    print(f"at 3 V it turns with {bench.read()['speed']:.1f} rad/s")

experiment = lh.Experiment(
    "steps",
    devices={"bench": {"plugin": "dc_motor", "address": "twin"}},
    steps=[
        {
            "device": "bench",
            "signal": "voltage",
            "excitation": "steps",
            "levels": [3.0, -2.0, 5.0, -5.0, 1.0],
            "dwell": 1.0,
            "duration": 5.0,
        }
    ],
)
print(experiment.plan())
with tempfile.TemporaryDirectory() as folder:
    rec = lh.run(experiment, folder)
    print(rec)
    print(lh.fit(rec, terms=["viscous_friction", "coulomb_friction"], estimator="nlse"))
