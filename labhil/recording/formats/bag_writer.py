"""Writer of ROS 2 bags: a topic per stream, with its own message type, whose definition is in the bag."""

from __future__ import annotations

import re
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from labhil.errors import UsageError
from labhil.extras import load_optional
from labhil.recording.recording import StreamData

BAG_VERSION = 9
PACKAGE = "labhil_msgs"


def write_bag(streams: Sequence[StreamData], out: Path) -> None:
    """Write streams as a bag with MCAP storage, topics ``/<device>/<stream>``.

    A message has ``header`` (stamp of the host's clock), ``seq``, ``t`` (s, the time of analysis) and the
    signals (SI units).

    Args:
        streams: the streams.
        out: the folder of the bag.

    Raises:
        UsageError: The folder exists, or its parent does not.
        MissingExtraError: rosbags is not installed.
    """
    purpose = f"{out}: writing a ROS 2 bag"
    rosbag2 = load_optional("rosbags.rosbag2", purpose)
    typesys = load_optional("rosbags.typesys", purpose)
    store = typesys.get_typestore(typesys.Stores.LATEST)
    if out.exists():
        raise UsageError(f"{out}: expected a new folder for the bag, found one that exists")
    if not out.parent.is_dir():
        raise UsageError(f"{out}: cannot be written: expected a folder {out.parent}, found none")
    plugin = rosbag2.StoragePlugin.MCAP
    try:
        with rosbag2.Writer(out, version=BAG_VERSION, storage_plugin=plugin) as writer:
            for data in streams:
                _write_stream(writer, typesys, store, data)
    except BaseException:
        shutil.rmtree(out, ignore_errors=True)
        raise


def _write_stream(writer: Any, typesys: Any, store: Any, data: StreamData) -> None:
    name = f"{PACKAGE}/msg/{_camel(data.device)}{_camel(data.stream.name)}"
    lines = ["std_msgs/Header header", "uint64 seq", "float64 t"]
    lines += [
        f"float64{'' if signal.width == 1 else f'[{signal.width}]'} {signal.name}"
        for signal in data.stream.signals
    ]
    store.register(typesys.get_types_from_msg("\n".join(lines) + "\n", name))
    message, header, stamp = (
        store.types[kind] for kind in (name, "std_msgs/msg/Header", "builtin_interfaces/msg/Time")
    )
    topic = f"/{data.device}/{data.stream.name}".replace("-", "_")
    connection = writer.add_connection(topic, name, typestore=store)
    columns = [(signal.width, data.stream.columns_of(signal.name)) for signal in data.stream.signals]
    for row, (seq, t_ns, t) in enumerate(
        zip(data.seq.tolist(), data.t_acq_ns.tolist(), data.t.tolist(), strict=True)
    ):
        values = [
            data.values[row, place] if width > 1 else float(data.values[row, place][0])
            for width, place in columns
        ]
        sec, nanosec = divmod(t_ns, 10**9)
        stamped_header = header(stamp=stamp(sec=sec, nanosec=nanosec), frame_id=data.device)
        writer.write(connection, t_ns, store.serialize_cdr(message(stamped_header, seq, t, *values), name))


def _camel(name: str) -> str:
    return "".join(part[:1].upper() + part[1:] for part in re.split(r"[^A-Za-z0-9]+", name))
