"""Fit every recording of a folder with the same model, and put the estimates side by side."""

from pathlib import Path

import labhil as lh

TERMS = ["viscous_friction", "coulomb_friction", "stribeck_friction", "dead_zone"]

rows = {}
for path in sorted(Path("recordings").glob("*.mcap")):
    try:
        fit = lh.fit(path, terms=TERMS, estimator="nlse", holdout=0.0)
    except lh.errors.LabhilError as error:
        print(f"{path}: {error}")
        continue
    rows[path.name] = fit.parameters

names = next(iter(rows.values())).keys()
print(f"{'':32}" + "".join(f"{path:>28}" for path in rows))
for name in names:
    cells = [f"{p[name].value:.5f} ± {p[name].std_error:.5f}" for p in rows.values()]
    print(f"{name:32}" + "".join(f"{cell:>28}" for cell in cells))
