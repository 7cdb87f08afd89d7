"""Layout for Foxglove: a chart for each unit, and the states below.

Foxglove has no field for units, so they are in the titles of charts and the labels of curves.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from labhil.signals import Direction, Signal, Stream


def foxglove_layout(streams: Iterable[tuple[str, Stream]]) -> dict[str, Any]:
    """Make a layout that Foxglove imports ("Import from file …").

    Args:
        streams: names of devices with their streams; those of a device share charts.

    Returns:
        JSON data.

    Example:
        >>> stream = Stream("state", (Signal("speed", "rad/s", Direction.OUTPUT),), 100.0)
        >>> layout = foxglove_layout([("motor", stream)])
        >>> layout["configById"]["Plot!motor-0"]["paths"][0]["value"]
        '/motor/state.speed'
    """
    panels: dict[str, dict[str, Any]] = {}
    by_device: dict[str, list[Stream]] = {}
    for device, stream in streams:
        by_device.setdefault(device, []).append(stream)
    for device, streams_of_device in by_device.items():
        for number, (unit, curves) in enumerate(_by_unit(device, streams_of_device).items()):
            panels[f"Plot!{device}-{number}"] = _chart(f"{device}, {unit or '1'}", curves)
    panels["StateTransitions!states"] = {
        "paths": [
            {"value": f"/{place}/event.state", "timestampMethod": "receiveTime"}
            for place in (*by_device, "run")
        ],
        "isSynced": True,
        "foxglovePanelTitle": "States",
    }
    return {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": _stack_panels(list(panels)),
    }


def _by_unit(device: str, streams: Sequence[Stream]) -> Mapping[str, list[dict[str, Any]]]:
    """Curves of a device by unit, in the order of their declaration."""
    curves: dict[str, list[dict[str, Any]]] = {}
    for stream in streams:
        for signal in stream.signals:
            curves.setdefault(signal.unit, []).extend(
                {
                    "value": f"/{device}/{stream.name}.{path}",
                    "enabled": True,
                    "timestampMethod": "receiveTime",
                    "label": _label(name, signal),
                }
                for path, name in _scalars(signal)
            )
    return curves


def _scalars(signal: Signal) -> list[tuple[str, str]]:
    """Path and name of each scalar of a signal."""
    if signal.width == 1:
        return [(signal.name, signal.name)]
    return [(f"{signal.name}[{k}]", column) for k, column in enumerate(signal.columns())]


def _label(name: str, signal: Signal) -> str:
    suffix = " requested" if signal.direction is Direction.REQUESTED else ""
    return f"{name}{suffix} [{signal.unit or '1'}]"


def _chart(title: str, curves: list[dict[str, Any]]) -> dict[str, Any]:
    return {
        "foxglovePanelTitle": title,
        "paths": curves,
        "showXAxisLabels": True,
        "showYAxisLabels": True,
        "showLegend": True,
        "legendDisplay": "floating",
        "showPlotValuesInLegend": True,
        "isSynced": True,
        "xAxisVal": "timestamp",
        "sidebarDimension": 240,
    }


def _stack_panels(names: Sequence[str]) -> Any:
    """Stack panels of equal height; Foxglove splits a panel into two at each level."""
    if len(names) == 1:
        return names[0]
    return {
        "direction": "column",
        "first": names[0],
        "second": _stack_panels(names[1:]),
        "splitPercentage": round(100 / len(names), 1),
    }
