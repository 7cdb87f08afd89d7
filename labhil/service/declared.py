"""What a host declares of its device: the stream of its commands, metadata, and safe values."""

from __future__ import annotations

from labhil.driver import DeviceInfo, Driver, DriverSpec
from labhil.host_clock import offset_ns
from labhil.recording.stamps import HOST_CLOCK
from labhil.service.messages import HostConfig
from labhil.signals import Direction, Signal, Stream


def command_stream(state: Stream, commands: tuple[Signal, ...]) -> Stream:
    """Return the stream of requested and applied values of each command.

    Args:
        state: The stream of samples, whose rate it has.
        commands: The commands.
    """
    signals: list[Signal] = []
    for signal in commands:
        for suffix, description in (("requested", "before limits"), ("applied", "sent to the device")):
            signals.append(
                Signal(
                    f"{signal.name}_{suffix}",
                    signal.unit,
                    Direction.REQUESTED,
                    width=signal.width,
                    hold=signal.hold,
                    description=f"{signal.name}, {description}",
                )
            )
    return Stream("command", tuple(signals), state.rate)


def safe_values(spec: DriverSpec) -> dict[str, float]:
    """Return the safe values by column; commands that keep their value in the safe state are left out."""
    values = {}
    for signal in spec.commands:
        for column in signal.columns():
            value = spec.safe.get(column, spec.safe.get(signal.name))
            if value is not None:
                values[column] = value
    return values


def stream_metadata(config: HostConfig, driver: Driver, info: DeviceInfo) -> dict[str, str]:
    """Return the metadata of a device's streams for a recording."""
    return {
        "plugin": config.plugin,
        "rig": driver.spec.rig,
        "address": config.address,
        "firmware": info.firmware,
        "serial": info.serial,
        "boot_id": str(info.boot_id),
        "speed": repr(info.speed),
        HOST_CLOCK: str(offset_ns()),
        **{f"calibration.{name}": repr(value) for name, value in info.calibration.items()},
    }
