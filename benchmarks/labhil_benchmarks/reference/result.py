"""What comes out: parts that are computed and kept one by one, and the tables made of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import Any

from labhil.analysis.results import finite
from labhil.identify.linear import Figures


class Way(StrEnum):
    """Where a value comes from."""

    TEXT_PSO = "text_pso"
    TEXT_NLSE = "text_nlse"
    SWARM = "swarm"
    ROUGH = "rough"
    DEFAULT = "default"


NAMES: Mapping[Way, str] = {
    Way.TEXT_PSO: "text: PSO",
    Way.TEXT_NLSE: "text: NLSE",
    Way.SWARM: "ours: text's swarm",
    Way.ROUGH: "ours: one least squares from a rough start",
    Way.DEFAULT: "ours: default",
}


@dataclass(frozen=True, slots=True)
class Belief:
    """What a fit says of its own errors, (rows,) each.

    ``std_errors`` are the robust ones, ``low`` and ``high`` the fit's 99 % intervals (of sums: Wald's);
    ``text_reach`` is half of the text's interval, 2.58·√C_ii/√n; ``bounds`` are Cramér-Rao's for the same
    windows with free states, None where there is none.
    """

    std_errors: tuple[float, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]
    text_reach: tuple[float, ...]
    bounds: tuple[float | None, ...]
    window: float


@dataclass(frozen=True, slots=True)
class Estimated:
    """One way's values (rows,), its residual in units of noise on the training run, errors on the test run.

    ``reached`` of ``starts`` rough starts ended in the lowest minimum.
    """

    values: tuple[float, ...]
    residual: float
    scores: tuple[Figures, ...]
    evaluations: int
    seconds: float
    starts: int = 0
    reached: int = 0
    belief: Belief | None = None


@dataclass(frozen=True, slots=True)
class Limits:
    """What the data allow.

    ``bounds`` (rows,) are Cramér-Rao's for one run from a known state, None where the data say nothing;
    ``combined`` those of the study's combinations of them. ``scores`` are the truth's own on the test run:
    the ceiling of R². ``text_pso`` and ``text_nlse`` are those of the text's printed values in our plant's
    data.
    """

    bounds: tuple[float | None, ...]
    combined: tuple[float | None, ...]
    scores: tuple[Figures, ...]
    text_pso: tuple[Figures, ...]
    text_nlse: tuple[Figures, ...]
    samples: int


@dataclass(frozen=True, slots=True)
class LinearModels:
    """Linear models on the data of a case: names, equations, errors on the test run."""

    names: tuple[str, ...]
    equations: tuple[str, ...]
    scores: tuple[Figures, ...]


@dataclass(frozen=True, slots=True)
class Figure:
    """A value, its error in % of the truth (None at zero) and in Cramér-Rao bounds (None without one)."""

    value: float
    error: float | None
    in_bounds: float | None

    @classmethod
    def of(cls, value: float, truth: float, bound: float | None) -> Figure:
        """Compare with the truth."""
        error = 100.0 * (value - truth) / abs(truth) if truth else None
        return cls(value, error, (value - truth) / bound if bound else None)


@dataclass(frozen=True, slots=True)
class Row:
    """One parameter: ``figures`` by way; the default's error and intervals; what the text prints of its own.

    ``default_bound`` is the bound for the windows that the default fits, ``bound`` that of a whole run.
    """

    symbol: str
    joint: int | None
    unit: str
    truth: float
    bound: float | None
    figures: Mapping[str, Figure]
    default_bound: float | None
    std_error: float | None
    interval: tuple[float, float] | None
    text_formula: tuple[float, float] | None
    text_interval: tuple[float, float] | None
    text_errors: tuple[str, str] | None


@dataclass(frozen=True, slots=True)
class ScoreRow:
    """Errors of one model on the test run: ``mse`` in unit², ``rmse`` and ``max_abs_error`` in unit, R² in %.

    ``printed_mse`` and ``printed_r2`` are what the text prints for this model, where it does.
    """

    model: str
    channel: str
    joint: int | None
    unit: str
    mse: float
    rmse: float
    r2: float
    max_abs_error: float
    printed_mse: float | None = None
    printed_r2: float | None = None


@dataclass(frozen=True, slots=True)
class Table:
    """One table of the text, filled: ``rows`` of parameters or ``scores`` of models."""

    number: str
    title: str
    variant: str
    setup: str
    rows: tuple[Row, ...] = ()
    scores: tuple[ScoreRow, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def heading(self) -> str:
        """Number, title and variant in one line."""
        return f"Table {self.number}: {self.title}" + (f" ({self.variant})" if self.variant else "")


@dataclass(frozen=True, slots=True)
class Reference:
    """All tables, with the findings on the text's claims; ``quick`` runs say less, and ``seed`` fixes all."""

    tables: tuple[Table, ...]
    findings: tuple[str, ...]
    quick: bool
    seed: int
    budget: str
    seconds: float

    def to_json(self) -> Any:
        """Plain JSON data without NaN or infinities."""
        return finite({"schema": "labhil.reference/1", **asdict(self)})


def estimated_from(data: Mapping[str, Any]) -> Estimated:
    """Read what ``asdict`` made of an :class:`Estimated`."""
    belief = None if data["belief"] is None else _belief_from(data["belief"])
    values, scores = tuple(data["values"]), _figures(data["scores"])
    return Estimated(**{**data, "values": values, "scores": scores, "belief": belief})


def _belief_from(data: Mapping[str, Any]) -> Belief:
    # what has no end was written as null; a bound of null is one that does not exist
    endless = {
        "std_errors": float("inf"),
        "low": -float("inf"),
        "high": float("inf"),
        "text_reach": float("inf"),
    }
    ends = {name: tuple(worst if x is None else x for x in data[name]) for name, worst in endless.items()}
    return Belief(**{**data, **ends, "bounds": tuple(data["bounds"])})


def limits_from(data: Mapping[str, Any]) -> Limits:
    """Read what ``asdict`` made of :class:`Limits`."""
    scores = {name: _figures(data[name]) for name in ("scores", "text_pso", "text_nlse")}
    bounds = {name: tuple(data[name]) for name in ("bounds", "combined")}
    return Limits(**{**data, **scores, **bounds})


def linear_from(data: Mapping[str, Any]) -> LinearModels:
    """Read what ``asdict`` made of :class:`LinearModels`."""
    return LinearModels(tuple(data["names"]), tuple(data["equations"]), _figures(data["scores"]))


def _figures(rows: Sequence[Mapping[str, Any]]) -> tuple[Figures, ...]:
    # a run that left all bounds has infinite errors, which JSON writes as null
    worst = {"mse": float("inf"), "rmse": float("inf"), "r2": -float("inf"), "max_abs_error": float("inf")}
    return tuple(
        Figures(**{name: worst[name] if value is None else value for name, value in row.items()})
        for row in rows
    )
