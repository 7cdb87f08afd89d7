"""What a host declares of its device: its stream of commands, what is said beside samples, safe values."""

from __future__ import annotations

from labhil.driver import DeviceInfo, Driver, DriverSpec
from labhil.service.messages import HostConfig
from labhil.signals import Direction, Signal, Stream


def command_stream(state: Stream, commands: tuple[Signal, ...]) -> Stream:
    """Return the declaration of what was requested and what was sent, per column of a command."""
    signals: list[Signal] = []
    for signal in commands:
        for column in signal.columns():
            for suffix, what in (("requested", "before limits"), ("applied", "sent to the device")):
                signals.append(
                    Signal(
                        f"{column}_{suffix}",
                        signal.unit,
                        Direction.REQUESTED,
                        hold=signal.hold,
                        description=f"{column}, {what}",
                    )
                )
    return Stream("command", tuple(signals), state.rate)


def safe_values(spec: DriverSpec) -> dict[str, float]:
    """Return the value of every column of every command in the safe state."""
    return {
        column: spec.safe[column] if column in spec.safe else spec.safe[signal.name]
        for signal in spec.commands
        for column in signal.columns()
    }


def stream_metadata(config: HostConfig, driver: Driver, info: DeviceInfo) -> dict[str, str]:
    """Return what is said of a device beside its samples: strings, as a recording wants them."""
    return {
        "plugin": config.plugin,
        "rig": driver.spec.rig,
        "address": config.address,
        "firmware": info.firmware,
        "serial": info.serial,
        "boot_id": str(info.boot_id),
        "speed": repr(info.speed),
        **{f"calibration.{name}": repr(value) for name, value in info.calibration.items()},
    }
