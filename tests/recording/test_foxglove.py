"""A layout for Foxglove asks for nothing that is not in the recording, and says every unit."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from mcap.reader import make_reader

from labhil import plugins
from labhil.cli import main
from labhil.recording.reader import read_recording

SHIPPED = Path(__file__).parents[2] / "recordings"
RECORDINGS = sorted(SHIPPED.glob("*.mcap"))


def made(arguments: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.argv", ["labhil", "layout", *arguments])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code in (0, None)


def paths_of(layout: dict[str, Any]) -> list[str]:
    panels = layout["configById"].values()
    return [path["value"] for panel in panels for path in panel["paths"]]


def named(tree: Any) -> list[str]:
    return [tree] if isinstance(tree, str) else [*named(tree["first"]), *named(tree["second"])]


def widths(path: Path) -> dict[str, bool]:
    """Every field of every stream, by its path; whether it is a vector. Read without labhil."""
    found: dict[str, bool] = {}
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    for channel in summary.channels.values():
        schema = summary.schemas[channel.schema_id]
        if schema.encoding != "protobuf":
            found[f"{channel.topic}.state"] = False
            continue
        (described,) = FileDescriptorSet.FromString(schema.data).file
        for field in described.message_type[0].field:
            found[f"{channel.topic}.{field.name}"] = field.label == field.LABEL_REPEATED
    return found


@pytest.mark.parametrize("path", RECORDINGS, ids=lambda path: path.stem)
def test_every_curve_of_a_layout_is_in_the_recording(
    path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "layout.json"
    made([str(path), "-o", str(out)], monkeypatch)
    layout, fields = json.loads(out.read_text()), widths(path)
    asked = paths_of(layout)
    for each in asked:
        name = re.sub(r"\[\d+\]$", "", each)
        assert fields[name] == (name != each), each
    signals = sum(data.stream.width for data in read_recording(path).streams if len(data))
    assert sum(".state" not in each.replace("/state.", "/") for each in asked) == signals
    assert sorted(named(layout["layout"])) == sorted(layout["configById"])


@pytest.mark.parametrize("driver", plugins.names(plugins.DRIVERS))
def test_there_is_a_layout_for_every_rig_before_anything_is_recorded(
    driver: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "layout.json"
    made([driver, "-o", str(out), "--device", "left"], monkeypatch)
    layout = json.loads(out.read_text())
    stream = plugins.load_driver(driver).spec.stream
    labels = [
        path["label"] for panel in layout["configById"].values() for path in panel["paths"] if "label" in path
    ]
    assert len(labels) == stream.width
    for signal in stream.signals:
        for column in signal.columns():
            assert f"{column} [{signal.unit or '1'}]" in labels
    assert all(path.startswith(("/left/", "/run/")) for path in paths_of(layout))
