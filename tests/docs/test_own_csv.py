"""The tutorial on a table of one's own, walked as it is written: files saved, commands typed."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "tutorials" / "your-own-csv.md"
BLOCK = re.compile(r"^```(\w*)\n(.*?)^```", re.DOTALL | re.MULTILINE)


def walk(folder: Path) -> list[tuple[str, subprocess.CompletedProcess[str]]]:
    """Each command of the page in its order, and what came of it; a rig file is saved where it stands."""
    done = []
    for language, text in BLOCK.findall(PAGE.read_text(encoding="utf-8")):
        if language == "python":
            subprocess.run([sys.executable, "-c", text], cwd=folder, check=True)
        elif language == "toml" and text.startswith("[rig]"):
            (folder / "bench.toml").write_text(text, encoding="utf-8")
        elif language == "sh":
            for line in text.splitlines():
                command = [str(Path(sys.executable).with_name("labhil")), *line.split()[1:]]
                result = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
                done.append((line, result))
    return done


@pytest.mark.extended
@pytest.mark.timeout(900)
def test_the_page_leads_from_a_table_to_what_the_model_lacks(tmp_path: Path) -> None:
    shutil.copytree(ROOT / "recordings", tmp_path / "recordings")
    (refused_line, refused), *accepted = walk(tmp_path)
    assert refused_line.startswith("labhil import")
    assert refused.returncode == 2
    assert f"```\n{refused.stderr}```" in PAGE.read_text(encoding="utf-8")
    assert [(line, result.stderr) for line, result in accepted if result.returncode] == []
    answer = accepted[-1][1].stdout
    concealed = ("dead_zone", "coulomb_friction", "stribeck_friction")
    assert [name for name in concealed if f"• {name} (" not in answer] == []
    assert (tmp_path / "diagnosis.png").stat().st_size > 10_000
    radius = re.search(r"^ball_radius +([\d.]+)", answer, re.MULTILINE)
    assert radius is not None
    assert float(radius[1]) == pytest.approx(0.02, rel=0.02)
