"""Settings of a twin besides its plant: the wire, the device's clock, and injected faults."""

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
    """Latency from sample to wire (s), the clock, and faults.

    Each fault happens once, ``fault_…_at`` s of the device's clock after the first SET of a run; 0 is never.
    After ``fault_silence_at`` nothing is sent until the next client. ``drop_rate`` is the share of frames
    that are lost.
    """

    latency: float = 0.001
    latency_jitter: float = 0.0005
    clock_drift: float = 50.0
    """Rate error of the device's clock, ppm; positive is too fast."""
    clock_start: float = 0.0
    """The device's clock at boot, s."""
    drop_rate: float = 0.0
    fault_reset_at: float = 0.0
    fault_garbage_at: float = 0.0
    fault_silence_at: float = 0.0


WIRE_PARAMETERS: Mapping[str, float] = {name: float(value) for name, value in asdict(WireSettings()).items()}

Resolve = Callable[[Iterable[str], Mapping[str, float]], Mapping[str, float]]


@dataclass(frozen=True, slots=True)
class Settable:
    """The parameters of one rig's twin.

    Attributes:
        default_terms: Effects of the plant by default.
        plant: Parameters of the plant with their defaults, SI.
        resolve: Returns the parameters for given terms and overrides.
        device: Parameters of the electronics with their defaults.
        check: Raises UsageError for parameters of the electronics that are out of range.
    """

    default_terms: tuple[str, ...]
    plant: Mapping[str, float]
    resolve: Resolve
    device: Mapping[str, float]
    check: Callable[[Mapping[str, float]], None]

    def parameters(self) -> dict[str, float]:
        """Return every parameter that ``--set`` takes with its default (SI; ``clock_drift`` in ppm)."""
        return dict(self.plant) | dict(self.device) | dict(WIRE_PARAMETERS)


UNEVEN = ("stamp_jitter", "stamp_error")
"""Parameters of a plant's recording that a device on the wire has not: it samples evenly by its clock."""


def settable_world(
    world: PlantDefinition,
    default_terms: tuple[str, ...],
    device: Mapping[str, float],
    check: Callable[[Mapping[str, float]], None],
) -> Settable:
    """Return the parameters of a twin on the wire.

    Args:
        world: The simulated plant.
        default_terms: Its effects by default.
        device: Parameters of the electronics with their defaults.
        check: As in :class:`Settable`.
    """
    visible = (name for name in world.all_parameters() if name.partition(".")[0] not in world.hidden)
    defaults = world.all_parameters()
    plant = {name: defaults[name] for name in visible if name not in UNEVEN}
    return Settable(default_terms, plant, world.resolve, device, check)


@dataclass(frozen=True, slots=True)
class TwinSettings:
    """Checked :class:`TwinOptions`, divided into those of the plant, the electronics and the wire.

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
        """Check the options of a twin; UsageError or UnknownNameError for a wrong one."""
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
            # parameters of an effect that is present may be known only to the plant
            if name not in known and effect not in terms:
                raise UnknownNameError("parameter", name, known)
        return cls(options.seed, options.speed, terms, settable.resolve(terms, given), device, wire)

    def answer(self) -> dict[str, object]:
        """Return the terms and parameters of the twin as JSON data: the true answer to a diagnosis."""
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
    """Raise UsageError where a parameter of the electronics is outside ``low`` … ``high``."""
    if not low <= device[name] <= high:
        raise UsageError(f"{name} must lie between {low:g} and {high:g}, found {device[name]:g}")


def check_whole(device: Mapping[str, float], name: str, low: int, high: int) -> None:
    """Raise UsageError where a parameter of the electronics is no whole number from ``low`` to ``high``."""
    check_range(device, name, low, high)
    if device[name] != int(device[name]):
        raise UsageError(f"{name} must be a whole number, found {device[name]:g}")
