"""What can be set about a twin beyond its plant: the wire, the device's clock, and faults to order."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass, field

from labhil.driver import TwinOptions
from labhil.errors import UnknownNameError, UsageError
from labhil.plants.definition import PlantDefinition
from labhil.signals import FloatArray

WIRES = ("pty", "tcp")


@dataclass(frozen=True, slots=True)
class WireSettings:
    """Latency (s) from sample to wire, the clock, and faults.

    Faults happen ``fault_…_at`` seconds of the device's clock after the first SET of a run, once in
    the life of the twin; 0 is never. After ``fault_silence_at`` nothing more is sent until the next
    client. ``drop_rate`` is the share of frames that get lost on the way.
    """

    latency: float = 0.001
    latency_jitter: float = 0.0005
    clock_drift: float = 50.0
    """How much the device's clock is too fast, in ppm."""
    clock_start: float = 0.0
    """What the device's clock shows at boot, s."""
    drop_rate: float = 0.0
    fault_reset_at: float = 0.0
    fault_garbage_at: float = 0.0
    fault_silence_at: float = 0.0


WIRE_PARAMETERS: Mapping[str, float] = {name: float(value) for name, value in asdict(WireSettings()).items()}

Resolve = Callable[[Iterable[str], Mapping[str, float]], Mapping[str, float]]


@dataclass(frozen=True, slots=True)
class Settable:
    """What one rig's twin can be made of.

    ``plant`` are the parameters of its plant with their defaults (SI), ``resolve`` makes those in force
    of terms and overrides; ``device`` are the numbers of its electronics, which ``check`` looks at
    (UsageError).
    """

    default_terms: tuple[str, ...]
    plant: Mapping[str, float]
    resolve: Resolve
    device: Mapping[str, float]
    check: Callable[[Mapping[str, float]], None]

    def parameters(self) -> dict[str, float]:
        """Every name that ``--set`` takes with its default (SI; ``clock_drift`` in ppm)."""
        return dict(self.plant) | dict(self.device) | dict(WIRE_PARAMETERS)


UNEVEN = ("stamp_jitter", "stamp_error")
"""Of what a plant's recording may suffer: a device on the wire samples evenly, by its own clock."""


def settable_world(
    world: PlantDefinition,
    default_terms: tuple[str, ...],
    device: Mapping[str, float],
    check: Callable[[Mapping[str, float]], None],
) -> Settable:
    """What a rig of that world can be made of on the wire."""
    visible = (name for name in world.all_parameters() if name.partition(".")[0] not in world.hidden)
    defaults = world.all_parameters()
    plant = {name: defaults[name] for name in visible if name not in UNEVEN}
    return Settable(default_terms, plant, world.resolve, device, check)


@dataclass(frozen=True, slots=True)
class TwinSettings:
    """A checked :class:`TwinOptions`: ``terms`` and ``plant`` make the plant, the rest what is around it.

    ``tables`` are measured maps by name, as the plant takes them.
    """

    seed: int
    speed: float
    terms: tuple[str, ...]
    plant: Mapping[str, float]
    device: Mapping[str, float]
    wire: WireSettings
    tables: Mapping[str, FloatArray] = field(default_factory=dict)

    @classmethod
    def of(cls, options: TwinOptions, settable: Settable) -> TwinSettings:
        """Check the options; UsageError or UnknownNameError names what is wrong."""
        if options.wire not in WIRES:
            raise UnknownNameError("wire", options.wire, WIRES)
        if options.host is not None or options.series is not None:
            raise UsageError("the twin of a serial device is on no network: it takes neither host nor series")
        if not 0.0 < options.speed <= 100.0:
            raise UsageError(f"speed must be above 0 and at most 100, found {options.speed:g}")
        given = dict(options.parameters)
        wire = _check_wire(
            WireSettings(**{name: float(given.pop(name)) for name in WIRE_PARAMETERS if name in given})
        )
        device_values = {name: float(given.pop(name)) for name in settable.device if name in given}
        device = dict(settable.device) | device_values
        settable.check(device)
        terms = settable.default_terms if options.terms is None else options.terms
        known = settable.parameters()
        for name in given:
            effect = name.partition(".")[0]
            # what no list of names tells is known to the plant alone
            if name not in known and effect not in terms:
                raise UnknownNameError("parameter", name, known)
        return cls(options.seed, options.speed, terms, settable.resolve(terms, given), device, wire)

    def answer(self) -> dict[str, object]:
        """What the twin is made of, as JSON data: the answer to the riddle that its recordings pose."""
        wire = {name: getattr(self.wire, name) for name in WIRE_PARAMETERS}
        parameters = {**self.plant, **self.device, **wire}
        content = {"terms": list(self.terms), "parameters": parameters, "seed": self.seed}
        return content | ({"tables": list(self.tables)} if self.tables else {})


def _check_wire(wire: WireSettings) -> WireSettings:
    for name in WIRE_PARAMETERS:
        value = getattr(wire, name)
        if not (0.0 <= value < float("inf") or (name == "clock_drift" and abs(value) < 1e5)):
            raise UsageError(f"{name} must not be negative, found {value:g}")
    if not wire.drop_rate <= 1.0:
        raise UsageError(f"drop_rate must lie between 0 and 1, found {wire.drop_rate:g}")
    return wire


def check_range(device: Mapping[str, float], name: str, low: float, high: float) -> None:
    """UsageError when a number of the electronics lies outside ``low`` … ``high``."""
    if not low <= device[name] <= high:
        raise UsageError(f"{name} must lie between {low:g} and {high:g}, found {device[name]:g}")


def check_whole(device: Mapping[str, float], name: str, low: int, high: int) -> None:
    """UsageError when a number of the electronics is no whole number from ``low`` to ``high``."""
    check_range(device, name, low, high)
    if device[name] != int(device[name]):
        raise UsageError(f"{name} must be a whole number, found {device[name]:g}")
