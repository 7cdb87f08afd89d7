"""Commands on files: bring in what others wrote, and take out what we wrote."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from labhil.console import deliver, refuse_unwritable, tell
from labhil.terminal import show, status

RunOption = Annotated[
    int | None,
    typer.Option("--run", metavar="N", help="Which run, from 1, where a file holds several of one stream."),
]


def add_files(app: typer.Typer) -> None:
    """Register these commands."""
    app.command("import", epilog="Example: labhil import bench.csv --rig ball_beam.toml -o bench.mcap")(
        import_
    )
    app.command(epilog="Example: labhil export run.mcap -o run.csv")(export)
    app.command(epilog="Example: labhil recover broken.mcap -o saved.mcap")(recover)


def import_(
    data: Annotated[Path, typer.Argument(help="A text table, MAT, Parquet, XLSX, or ROS 2 bag.")],
    rig: Annotated[
        Path, typer.Option(help="The rig file; its [table] and [channels] say how to read the data.")
    ],
    out: Annotated[Path, typer.Option("-o", "--out", help="The recording to write (.mcap).")],
) -> None:
    """Make a recording of a table that others wrote."""
    from labhil.analysis.doubts import doubts_in
    from labhil.analysis.import_check import checked
    from labhil.recording.reader import read_recording
    from labhil.recording.tables import describe_import, import_table, write_import
    from labhil.rig import load_rig

    table = import_table(data, load_rig(rig))
    tell(describe_import(table))
    with status() as say:
        table, seen = checked(table, say)
    tell(seen)
    path = write_import(table, out)
    faults = (fault for data in read_recording(path).streams for fault in data.clock_faults)
    tell(f"{data}: {fault.statement}" for fault in faults)
    tell(doubts_in(read_recording(path)))
    show(path)


def export(
    recording: Annotated[Path, typer.Argument(help="A recording (.mcap).")],
    out: Annotated[
        Path,
        typer.Option(
            "-o", "--out", help="What to write: .csv, .parquet, .mat, .xlsx or .rosbag2 (a folder)."
        ),
    ],
    device: Annotated[
        str | None, typer.Option(metavar="NAME", help="Which device, where a recording holds several.")
    ] = None,
    stream: Annotated[
        str | None, typer.Option(metavar="/DEVICE/STREAM", help="Which stream (default: state).")
    ] = None,
    run: RunOption = None,
) -> None:
    """Write the samples of a recording as a table: a column t (s), then the signals in SI units.

    A ROS 2 bag holds all streams; the others hold one.
    """
    from labhil.recording.export import export as write_table
    from labhil.recording.reader import read_recording

    found = read_recording(recording, run).of_device(device)
    tell(found.losses())
    show(write_table(found, out, stream))


def recover(
    broken: Annotated[Path, typer.Argument(help="A recording that is cut, damaged or without an end.")],
    out: Annotated[
        Path, typer.Option("-o", "--out", help="The recording to write (.mcap); never overwrites.")
    ],
    *,
    keep_doubtful: Annotated[
        bool,
        typer.Option(
            "--keep-doubtful", help="Keep messages of chunks whose checksum is wrong: values may be wrong."
        ),
    ] = False,
    json_path: Annotated[Path | None, typer.Option("--json", help="Write what was lost here.")] = None,
) -> None:
    """Save every whole message of a broken recording, and say what was lost.

    Takes any MCAP file, also a .part that a killed recorder left. What is written is read back and
    compared before it gets its name.
    """
    from labhil.recording.recover import recover as save

    refuse_unwritable(json_path, out)
    result = save(broken, out, keep_doubtful=keep_doubtful)
    tell(result.lines())
    deliver(result.to_json(), json_path, lambda: show(result.path))
