"""What can be set about a twin beyond its plant: the wire, the device's clock, and faults to order."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass

from labhil.driver import TwinOptions
from labhil.errors import UnknownNameError, UsageError
from labhil.plants.effects import all_parameters, resolve

DEFAULT_TERMS = ("viscous_friction", "coulomb_friction", "stribeck_friction")
WIRES = ("pty", "tcp")


@dataclass(frozen=True, slots=True)
class WireSettings:
    """Latency (s) from sample to wire, the clock, and faults.

    Faults happen ``fault_…_at`` seconds of the device's clock after the first SET of a run, once in
    the life of the twin; 0 is never. After ``fault_silence_at`` nothing more is sent until the next
    client. ``drop_rate`` is the share of samples that get lost on the way.
    """

    latency: float = 0.001
    latency_jitter: float = 0.0005
    clock_drift: float = 50.0
    """How much the device's clock is too fast, in ppm."""
    clock_start: float = 0.0
    """What the device's clock shows at boot, s."""
    pulse_resolution: float = 1e-6
    """Step of the servo's pulse width, s; 180° are 1 ms."""
    drop_rate: float = 0.0
    fault_reset_at: float = 0.0
    fault_garbage_at: float = 0.0
    fault_silence_at: float = 0.0


WIRE_PARAMETERS: Mapping[str, float] = {name: float(value) for name, value in asdict(WireSettings()).items()}


@dataclass(frozen=True, slots=True)
class TwinSettings:
    """A checked :class:`TwinOptions`: ``terms`` and ``plant`` make the plant, ``wire`` the rest."""

    seed: int
    speed: float
    terms: tuple[str, ...]
    plant: Mapping[str, float]
    wire: WireSettings

    @classmethod
    def of(cls, options: TwinOptions) -> TwinSettings:
        """Check the options; UsageError or UnknownNameError names what is wrong."""
        if options.wire not in WIRES:
            raise UnknownNameError("wire", options.wire, WIRES)
        if options.host is not None or options.series is not None:
            raise UsageError(
                "the twin of a ball_beam is no networked device: it takes neither host nor series"
            )
        if not 0.0 < options.speed <= 100.0:
            raise UsageError(f"speed must be above 0 and at most 100, found {options.speed:g}")
        given = dict(options.parameters)
        wire = _checked(
            WireSettings(**{name: float(given.pop(name)) for name in WIRE_PARAMETERS if name in given})
        )
        _refuse_unknown(given)
        terms = DEFAULT_TERMS if options.terms is None else options.terms
        return cls(options.seed, options.speed, terms, resolve(terms, given), wire)

    def answer(self) -> dict[str, object]:
        """What the twin is made of, as JSON data: the answer to the riddle that its recordings pose."""
        wire = {name: getattr(self.wire, name) for name in WIRE_PARAMETERS}
        return {"terms": list(self.terms), "parameters": {**self.plant, **wire}, "seed": self.seed}


def twin_parameters() -> dict[str, float]:
    """Return every name that ``--set`` takes with its default (SI; ``clock_drift`` in ppm)."""
    return all_parameters() | dict(WIRE_PARAMETERS)


def _refuse_unknown(given: Mapping[str, float]) -> None:
    known = twin_parameters()
    for name in given:
        if name not in known:
            raise UnknownNameError("parameter", name, known)


def _checked(wire: WireSettings) -> WireSettings:
    for name in WIRE_PARAMETERS:
        value = getattr(wire, name)
        if not (0.0 <= value < float("inf") or (name == "clock_drift" and abs(value) < 1e5)):
            raise UsageError(f"{name} must not be negative, found {value:g}")
    if not wire.drop_rate <= 1.0:
        raise UsageError(f"drop_rate must lie between 0 and 1, found {wire.drop_rate:g}")
    if not 1e-7 <= wire.pulse_resolution <= 1e-4:
        raise UsageError(
            f"pulse_resolution must lie between 1e-7 and 1e-4 s, found {wire.pulse_resolution:g}"
        )
    return wire
