"""Find what a model lacks: here it knows viscous friction only. Draw the effects, and write a page."""

import labhil as lh

dx = lh.diagnose(
    "recordings/ball_beam_identify.mcap",
    baseline=["viscous_friction"],
    test="recordings/ball_beam_test.mcap",
    progress=True,
)
print(dx)

for effect in dx.missing:
    print(f"\n{effect.term}, probability {effect.probability:.2f}: {effect.equation}")
    for parameter in effect.parameters:
        print(f"  {parameter}")
    name = f"{effect.term}.png"
    dx.plot_effect(effect.term).figure.savefig(name)
    print(f"  drawn: {name}")
print(f"\nA page about it: {dx.report('diagnosis.html')}")
