"""The reference text's tables 5.3 and 5.8 to 5.13 from recordings made over the wire.

    python benchmarks/over_the_wire.py --out reference-recordings
    python benchmarks/over_the_wire.py --out reference-recordings --only solenoid --fit-only

Each case's twin carries the plant of the text's table; `labhil run` drives it through its real driver with
the signal of the text and records it, once to identify and once to test. `labhil fit` gets the terms of the
text, and nothing of their values. Beside the table stand R² and RMSE of the test signal: over the
windows of the fit, and, as the text has it, over one run of the whole recording from rest.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from labhil.analysis.dataset import load_dataset
from labhil.identify.fitted import start_theta
from labhil.physics.record import Windows
from labhil_benchmarks.reference import published
from labhil_benchmarks.reference.known_start import KnownStart
from labhil_benchmarks.reference.levels import Levels

HERE = Path(__file__).parent / "over_the_wire"
SEVERAL = "viscous_friction,coulomb_friction,stribeck_friction"
CUBIC = f"{SEVERAL},quadratic_viscous_friction,cubic_viscous_friction"
REACH_99 = 2.5758


@dataclass(frozen=True, slots=True)
class Case:
    """A rig of the text: its two tables, and the terms that are fitted."""

    name: str
    parameters: published.ParameterTable
    quality: published.QualityTable
    terms: str

    @property
    def truth(self) -> list[float]:
        """The twin's values: the text's true ones, or those of its swarm where it states none."""
        absent = {"F_v2", "F_v3", "U_l", "U_r"}
        return [
            0.0 if row.symbol in absent else row.pso if row.real is None else row.real
            for row in self.parameters.rows
        ]


CASES = (
    Case("motor", published.TABLE_5_3, published.TABLE_5_4, CUBIC),
    Case("solenoid", published.TABLE_5_8, published.TABLE_5_9, SEVERAL),
    Case("bare_beam", published.TABLE_5_10, published.TABLE_5_11, f"{CUBIC},dead_zone,time_delay"),
    Case("paper_tape", published.TABLE_5_12, published.TABLE_5_13, f"{CUBIC},dead_zone,time_delay"),
)


def labhil(*arguments: object) -> int:
    """Run a command of labhil; gives its exit status."""
    command = [sys.executable, "-m", "labhil", *map(str, arguments)]
    print("labhil " + " ".join(command[3:]), file=sys.stderr, flush=True)
    return subprocess.run(command, check=False, stdout=subprocess.DEVNULL).returncode


def recordings_of(case: Case, out: Path) -> tuple[Path, Path]:
    """Where the two recordings of a case go."""
    plain = case.name.replace("_", "-")
    return out / f"{plain}-identify.mcap", out / f"{plain}-test.mcap"


def record(case: Case, out: Path) -> None:
    """Record what is not there yet; SystemExit where a run does not come to its end."""
    for path, what in zip(recordings_of(case, out), ("identify", "test"), strict=True):
        if not path.exists() and labhil("run", HERE / f"{case.name}_{what}.toml", "--out", out):
            path.unlink(missing_ok=True)
            raise SystemExit("the recording is not whole, and was thrown away")


def fit_case(case: Case, out: Path) -> dict[str, Any]:
    """Fit a case, and return its table."""
    identify, test = recordings_of(case, out)
    result = out / f"{case.name}.json"
    if labhil("fit", identify, "--test", test, "--terms", case.terms, "--json", result):
        raise SystemExit(f"{identify} could not be fitted")
    fit = json.loads(result.read_text(encoding="utf-8"))
    rows = {row["name"]: row for row in fit["parameters"]}
    levels, names = Levels(case.parameters.rows), list(rows)
    values = levels.to_text({name: row["value"] for name, row in rows.items()})
    spread = np.sqrt(np.diag(levels.covariance(np.array(fit["covariance"]), names)))
    return {
        "case": case.name,
        "table": case.parameters.number,
        "parameters": [
            {
                "symbol": row.symbol,
                "unit": row.unit,
                "truth": truth,
                "value": value,
                "ci99": rows[row.keys[0]]["ci99"]
                if len(row.keys) == 1
                else [value - REACH_99 * error, value + REACH_99 * error],
                "text_pso": row.pso,
                "text_nlse": row.nlse,
            }
            for row, truth, value, error in zip(
                case.parameters.rows, case.truth, values.tolist(), spread.tolist(), strict=True
            )
        ],
        "quality_table": case.quality.number,
        "test_windows": fit["test"],
        "test_from_rest": from_rest(identify, test, {name: row["value"] for name, row in rows.items()}),
        "text_r2_percent": {row.model: row.r2 for row in case.quality.rows},
    }


def from_rest(identify: Path, test: Path, values: dict[str, float]) -> list[dict[str, Any]]:
    """Errors of one run over the whole test from rest, which the text's figures are of."""
    dataset = load_dataset(identify, None, test)
    judged, model = dataset.test, dataset.model
    known = KnownStart(model, np.zeros(len(model.state_names)))
    windows = Windows.of([(0, len(judged))])
    simulated = known.simulate(start_theta(model, values), judged, windows, np.empty((1, 0)))
    rows = []
    for name, unit, y, x in zip(
        judged.output_names, judged.output_units, judged.outputs.T, simulated.T, strict=True
    ):
        mse = float(np.mean((y - x) ** 2))
        r2 = 1.0 - mse / float(np.var(y))
        rows.append({"channel": name, "unit": unit, "rmse": float(np.sqrt(mse)), "mse": mse, "r2": r2})
    return rows


def table(case: dict[str, Any]) -> str:
    """One case in Markdown."""
    lines = [
        f"Table {case['table']} ({case['case'].replace('_', ' ')})",
        "",
        "| parameter | text, PSO | text, NLSE | truth of the twin | ours | 99 % interval | |",
        "|---|---|---|---|---|---|---|",
    ]
    for row in case["parameters"]:
        low, high = (float("nan") if end is None else end for end in row["ci99"])
        holds = "covered" if low <= row["truth"] <= high else "**missed**"
        numbers = [f"{row[key]:.4g}" for key in ("text_pso", "text_nlse", "truth", "value")]
        lines.append(
            f"| {row['symbol']}, {row['unit']} | {' | '.join(numbers)} | {low:.4g} … {high:.4g} | {holds} |"
        )
    return "\n".join([*lines, "", *_quality(case)])


def _quality(case: dict[str, Any]) -> Sequence[str]:
    text = ", ".join(f"{r2:g} % ({model})" for model, r2 in case["text_r2_percent"].items())
    lines = [f"Table {case['quality_table']}, R² on the test signal; the text has {text}:"]
    for row in case["test_from_rest"]:
        channel = next(c for c in case["test_windows"]["per_channel"] if c["channel"] == row["channel"])
        lines.append(
            f"- {row['channel']}: one run from rest {100 * row['r2']:.2f} % at an RMSE of {row['rmse']:.3g}"
            f" {row['unit']}; windows {100 * channel['r2']:.2f} % at {channel['rmse']:.3g} {row['unit']}"
        )
    return lines


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("reference-recordings"), help="recordings go there")
    parser.add_argument("--only", nargs="+", choices=[case.name for case in CASES], metavar="CASE")
    parser.add_argument("--record-only", action="store_true")
    parser.add_argument("--fit-only", action="store_true")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all numbers here")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    chosen = [case for case in CASES if options.only is None or case.name in options.only]
    if not options.fit_only:
        for case in chosen:
            record(case, options.out)
    if options.record_only:
        return
    tables = [fit_case(case, options.out) for case in chosen]
    print("\n\n".join(table(fitted_case) for fitted_case in tables))
    if options.json is not None:
        report = {"schema": "labhil.over_the_wire/1", "cases": tables}
        options.json.write_text(json.dumps(report, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
