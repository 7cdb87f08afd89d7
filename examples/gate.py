"""Hold recordings against an accepted model: exit status 1 when one contradicts it, as in a pipeline."""

import sys

import labhil as lh

accepted = lh.Fit.load("examples/fit.json")
recordings = sys.argv[1:] or ["recordings/ball_beam_test.mcap"]
contradicted = False
for path in recordings:
    verification = lh.verify(path, accepted)
    print(f"{path}: {'contradicts the model' if verification.contradicted else 'consistent'}")
    for reason in verification.reasons:
        print(f"  {reason}")
    contradicted |= verification.contradicted
sys.exit(1 if contradicted else 0)
