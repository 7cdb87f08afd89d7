"""What a host declares of its device: its stream of commands, metadata beside its samples, safe values."""

from __future__ import annotations

from labhil.driver import DeviceInfo, Driver, DriverSpec
from labhil.host_clock import offset_ns
from labhil.recording.stamps import HOST_CLOCK
from labhil.service.messages import HostConfig
from labhil.signals import Direction, Signal, Stream


def command_stream(state: Stream, commands: tuple[Signal, ...]) -> Stream:
    """Return the declaration of what was requested and what was sent, per command signal."""
    signals: list[Signal] = []
    for signal in commands:
        for suffix, what in (("requested", "before limits"), ("applied", "sent to the device")):
            signals.append(
                Signal(
                    f"{signal.name}_{suffix}",
                    signal.unit,
                    Direction.REQUESTED,
                    width=signal.width,
                    hold=signal.hold,
                    description=f"{signal.name}, {what}",
                )
            )
    return Stream("command", tuple(signals), state.rate)


def safe_values(spec: DriverSpec) -> dict[str, float]:
    """Return the values of the commands in the safe state, by column; without those that stay as they are."""
    values = {}
    for signal in spec.commands:
        for column in signal.columns():
            value = spec.safe.get(column, spec.safe.get(signal.name))
            if value is not None:
                values[column] = value
    return values


def stream_metadata(config: HostConfig, driver: Driver, info: DeviceInfo) -> dict[str, str]:
    """Return the metadata of a device beside its samples: strings, as a recording wants them."""
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
