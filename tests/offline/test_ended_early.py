"""Results that are saved whatever becomes of stdout, and what there is of them when work is ended early."""

from __future__ import annotations

import importlib
import json
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import pytest

from labhil.analysis.dataset import Dataset, load_dataset
from labhil.analysis.study import diagnose_study, fit_study
from labhil.console import STDOUT, deliver
from labhil.ending import Deadline, EndedEarly, checkpoint
from labhil.identify.fit import Options
from labhil.interrupted import INTERRUPTED

RECORDING = Path(__file__).parents[2] / "recordings" / "ball_beam_identify.mcap"
LABHIL = [sys.executable, "-P", "-m", "labhil"]


@pytest.fixture(scope="module")
def dataset() -> Dataset:
    return load_dataset([RECORDING], span=(0.0, 20.0))


@pytest.mark.extended
@pytest.mark.parametrize("moment", ["fitting", "looking for other", "looking for lower", "statistics"])
def test_a_fit_that_is_ended_early_gives_the_best_so_far(dataset: Dataset, moment: str) -> None:
    with Deadline() as deadline:

        def progress(text: str) -> None:
            if text.startswith(moment):
                deadline.reason = "a test"

        options = Options(estimator="nlse", progress=progress)
        result = fit_study(dataset, terms=["viscous_friction"], options=options)
    assert result.json["complete"] is False
    assert len(result.json["by_window"]) == {"fitting": 1, "looking for other": 1}.get(moment, 4)
    assert result.json["train"]["rmse"] > 0.0


@pytest.mark.extended
@pytest.mark.parametrize("moment", ["fitting the baseline", "evidence of all"])
def test_a_diagnosis_that_is_ended_early_claims_no_more_than_it_tried(dataset: Dataset, moment: str) -> None:
    with Deadline() as deadline:

        def progress(text: str) -> None:
            if text.startswith(moment):
                deadline.reason = "a test"

        result = diagnose_study(dataset, baseline=["viscous_friction"], progress=progress)
    assert result.json["complete"] is False
    assert result.json["missing"] == []
    assert result.json["verdict"] in ("not_decidable", "no_mismatch")


@pytest.mark.extended
@pytest.mark.parametrize(
    ("module", "function"),
    [
        ("labhil.diagnose.diagnosis", "leaves_only_noise"),
        ("labhil.diagnose.structures.stages", "_validated_claims"),
        ("labhil.diagnose.diagnosis", "refit_to_held_out"),
    ],
)
def test_a_diagnosis_has_an_answer_between_its_steps_too(
    monkeypatch: pytest.MonkeyPatch, module: str, function: str
) -> None:
    rest = getattr(importlib.import_module(module), function)

    def ended_here(*arguments: Any) -> Any:
        deadline.reason = "a test"
        return rest(*arguments)

    monkeypatch.setattr(f"{module}.{function}", ended_here)
    with Deadline() as deadline:
        result = diagnose_study(load_dataset([RECORDING], span=(0.0, 16.0)), baseline=["viscous_friction"])
    assert deadline.reason
    assert result.json["complete"] is False
    assert result.json["baseline"]["parameters"]


def test_a_deadline_ends_once_and_then_lets_finish() -> None:
    checkpoint()
    with Deadline(0.0) as deadline:
        time.sleep(0.01)
        with pytest.raises(EndedEarly, match="0 s are over"):
            checkpoint()
        deadline.accept()
        checkpoint()
    with Deadline() as deadline:
        os.kill(os.getpid(), signal.SIGINT)
        with pytest.raises(EndedEarly, match="SIGINT"):
            checkpoint()
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(1.0)


@pytest.mark.extended
@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM], ids=lambda how: how.name)
def test_ctrl_c_ends_a_fit_with_a_marked_result(tmp_path: Path, how: signal.Signals) -> None:
    path = tmp_path / "fit.json"
    command = [*LABHIL, "fit", str(RECORDING), "--json", str(path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None and process.stderr is not None
        next(line for line in process.stderr if line.startswith("fitting"))
        process.send_signal(how)
        drain = threading.Thread(target=process.stderr.read)
        drain.start()
        shown = process.stdout.read()
        drain.join()
        assert process.wait(60.0) == 0
    assert shown.startswith(f"ENDED EARLY ({how.name})")
    assert json.loads(path.read_text())["complete"] is False


def test_ctrl_c_before_there_is_a_result_says_so(labhil: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*_arguments: Any, **_options: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("labhil.api.fit.fit", interrupted)
    done = labhil("fit", RECORDING)
    assert done.status == INTERRUPTED
    assert "interrupted (Ctrl+C) before there was a result; run the command again" in done.err


def shown(
    *arguments: str, encoding: str = "utf-8", stdout: int | None = subprocess.PIPE
) -> tuple[int, bytes, str]:
    environment = {**os.environ, "PYTHONIOENCODING": encoding}
    done = subprocess.run(
        [*LABHIL, *arguments],
        stdout=stdout,
        stderr=subprocess.PIPE,
        check=False,
        timeout=110,
        env=environment,
    )
    return done.returncode, done.stdout, done.stderr.decode()


@pytest.mark.extended
def test_a_terminal_with_few_characters_and_a_reader_that_leaves_are_no_failure() -> None:
    status, out, err = shown("terms", "ball_beam", encoding="cp1252")
    assert (status, err) == (0, "") and b"stribeck_friction" in out
    status, out, err = shown("terms", "ball_beam", "--json", "-", encoding="ascii")
    assert (status, err) == (0, "") and json.loads(out)
    reading, writing = os.pipe()
    os.close(reading)
    status, _, err = shown("--version", stdout=writing)
    os.close(writing)
    assert (status, err) == (0, "")
    with Path("/dev/full").open("wb") as full:
        status, _, err = shown("--version", stdout=full.fileno())
    assert status == 1 and "stdout could not be written" in err


def test_a_result_is_saved_before_it_is_shown(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "result.json"

    def fails() -> None:
        raise UnicodeEncodeError("cp1252", "β", 0, 1, "no such character")

    with pytest.raises(UnicodeEncodeError):
        deliver({"value": "β"}, path, fails)
    assert json.loads(path.read_text(encoding="utf-8")) == {"value": "β"}
    deliver({"value": 1}, STDOUT, fails)
    assert json.loads(capsys.readouterr().out) == {"value": 1}
