"""Fit a recording, test the model on another one, read the result and save it."""

import labhil as lh

fit = lh.fit(
    "recordings/ball_beam_identify.mcap",
    terms=["viscous_friction", "coulomb_friction", "stribeck_friction", "dead_zone"],
    test="recordings/ball_beam_test.mcap",
)
print(fit)

level = fit.parameters["coulomb_friction.level"]
low, high = level.ci99
print(f"\nCoulomb friction: {level.value:.4f} {level.unit}, 99 % between {low:.4f} and {high:.4f}")
print(f"Error on data that it has not seen: {fit.test.rmse:.2g} {fit.test.unit}")

print(f"Saved: {fit.save('fit.json')}; drawn: fit.png")
fit.figure().savefig("fit.png")
