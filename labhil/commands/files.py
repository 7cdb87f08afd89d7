"""Commands on files: ``labhil import``, ``export``, ``layout``, ``recover``, ``info`` and ``list``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from labhil.commands.json_flag import JsonFlagCommand, JsonOption
from labhil.console import deliver, refuse_unwritable, tell, write_json
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
    app.command(epilog="Example: labhil layout run.mcap -o bench.json")(layout)
    app.command(epilog="Example: labhil recover broken.mcap -o saved.mcap")(recover)
    app.command(cls=JsonFlagCommand, epilog="Example: labhil info run.mcap")(info)
    app.command("list", cls=JsonFlagCommand, epilog="Example: labhil list recordings --tag cold --rig axis")(
        list_
    )


def info(
    recording: Annotated[Path, typer.Argument(help="A recording (.mcap), also an unfinished .part.")],
    run: RunOption = None,
    json_path: JsonOption = None,
) -> None:
    """Show the contents of a recording: streams, rates, gaps, clocks, events, tags, matching rig kinds."""
    from labhil.recording.contents import describe_contents, format_contents
    from labhil.recording.reader import read_recording

    refuse_unwritable(json_path)
    contents = describe_contents(read_recording(recording, run))
    deliver(contents, json_path, lambda: show(*format_contents(contents)))


def list_(
    folders: Annotated[
        list[Path] | None, typer.Argument(help="Where to look, and below (default: here).")
    ] = None,
    *,
    tags: Annotated[
        list[str] | None, typer.Option("--tag", metavar="TAG", help="Only with this tag; may be repeated.")
    ] = None,
    rig: Annotated[str | None, typer.Option(metavar="KIND", help="Only of this kind of rig.")] = None,
    since: Annotated[
        str | None, typer.Option(metavar="DATE", help="Only from then on: 2026-05-31, 2026-05-31T14:00.")
    ] = None,
    until: Annotated[str | None, typer.Option(metavar="DATE", help="Only from before then.")] = None,
    text: Annotated[
        str | None,
        typer.Option(help="Only with this text in path, notes, operator, sample, tags or markers."),
    ] = None,
    json_path: JsonOption = None,
) -> None:
    """List recordings and results, the newest first."""
    from labhil.kinds import kind_named
    from labhil.recording.listing import Filter, format_list, list_folder, parse_moment

    refuse_unwritable(json_path)
    wanted = Filter(
        tuple(tags or ()),
        None if rig is None else kind_named(rig).name,
        None if since is None else parse_moment(since, "--since"),
        None if until is None else parse_moment(until, "--until"),
        text,
    )
    with status() as progress:
        progress("reading recordings")
        entries = list_folder(folders or [Path()], wanted)
    data = {"schema": "labhil.list/1", "files": [entry.to_json() for entry in entries]}
    if not entries:
        tell(["no recordings and no results"])
    deliver(data, json_path, lambda: show(*format_list(entries)))


def import_(
    data: Annotated[
        Path,
        typer.Argument(
            help="A text table, MAT, Parquet, XLSX, MCAP, npz, a ROS 2 bag, or a LeRobot dataset."
        ),
    ],
    rig: Annotated[
        Path, typer.Option(help="The rig file; its [table] and [channels] define how to read the data.")
    ],
    out: Annotated[Path, typer.Option("-o", "--out", help="The recording to write (.mcap).")],
    episode: Annotated[
        int | None,
        typer.Option(
            metavar="N", min=0, help="Which episode of a LeRobot dataset; [table] episode says so, too."
        ),
    ] = None,
) -> None:
    """Make a recording of a table of measured data."""
    from labhil.analysis.doubts import doubts_in
    from labhil.analysis.import_check import check_table
    from labhil.recording.import_report import describe_import
    from labhil.recording.reader import read_recording
    from labhil.recording.tables import import_table, with_episode, write_import
    from labhil.rig import load_rig

    table = import_table(data, with_episode(load_rig(rig), episode))
    tell(describe_import(table))
    with status() as progress:
        table, findings = check_table(table, progress)
    tell(findings)
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
            "-o", "--out", help="What to write: .csv, .parquet, .mat, .xlsx, .npz or .rosbag2 (a folder)."
        ),
    ],
    device: Annotated[
        str | None, typer.Option(metavar="NAME", help="Which device, where a recording holds several.")
    ] = None,
    stream: Annotated[
        str | None, typer.Option(metavar="/DEVICE/STREAM", help="Which stream (default: state).")
    ] = None,
    run: RunOption = None,
    rig: Annotated[
        Path | None, typer.Option(help="For .npz: the rig file whose [model] names a MuJoCo file.")
    ] = None,
) -> None:
    """Write the samples of a recording as a table: a column t (s), then the signals in SI units.

    A ROS 2 bag holds all streams, the other formats one. An .npz file is a trajectory for mujoco.sysid.
    """
    from labhil.recording.export import choose_stream
    from labhil.recording.export import export as export_table
    from labhil.recording.reader import read_recording

    source = read_recording(recording, run).of_device(device)
    tell(source.warnings())
    if out.suffix.lower() != ".npz":
        show(export_table(source, out, stream))
        return
    from labhil.rig import load_rig
    from labhil.simulators.sysid_file import write_sysid

    written = write_sysid(choose_stream(source, stream), None if rig is None else load_rig(rig), out)
    tell(written.notes)
    show(written.path)


def layout(
    what: Annotated[
        str, typer.Argument(metavar="RECORDING|DRIVER", help="A recording, or a name of `labhil devices`.")
    ],
    out: Annotated[Path, typer.Option("-o", "--out", help="The layout to write (.json).")],
    device: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="With a driver: the device's name in experiments (bench)."),
    ] = None,
) -> None:
    """Write a layout for Foxglove: a chart for each unit of a rig's signals, and the states below.

    Foxglove opens the recording itself; PlotJuggler and rerun do, too, and need no layout.
    """
    from labhil.plugins import load_driver
    from labhil.recording.foxglove import foxglove_layout
    from labhil.recording.reader import read_recording

    if what.endswith((".mcap", ".part")):
        streams = [(data.device, data.stream) for data in read_recording(Path(what)).streams if len(data)]
    else:
        streams = [(device or "bench", load_driver(what).spec.stream)]
    write_json(foxglove_layout(streams), out)
    show(out)


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
    json_path: Annotated[Path | None, typer.Option("--json", help="Write the losses here (JSON).")] = None,
) -> None:
    """Save every complete message of a broken recording, and report the losses.

    Takes any MCAP file, also a .part that a killed recorder left. The new file is read back and compared
    before it gets its name.
    """
    from labhil.recording.recover import recover as recover_messages

    refuse_unwritable(json_path, out)
    result = recover_messages(broken, out, keep_doubtful=keep_doubtful)
    tell(result.lines())
    deliver(result.to_json(), json_path, lambda: show(result.path))
