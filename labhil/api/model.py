"""``labhil.model``: the white-box model of a rig, and its catalogue of effects."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from labhil.api.inputs import PathLike, rig_file
from labhil.api.render import data_frame, html_of, text_of
from labhil.errors import UnknownNameError, UsageError
from labhil.extras import require_analysis
from labhil.rig import RigFile, parse_rig
from labhil.toml_text import to_toml

if TYPE_CHECKING:
    from rich.console import RenderableType

    from labhil.api.recording import Recording
    from labhil.physics.terms import Term
    from labhil.signals import Signal


class Terms(Mapping[str, "Term"]):
    """The catalogue of a model: every effect that it may have, by name; prints as a table.

    Each has its ``equation``, ``statement``, ``source``, ``revealed_by``, ``needs`` and ``parameters``.

    Example:
        >>> import labhil as lh
        >>> terms = lh.model("dc_motor").terms
        >>> terms["brush_drop"].equation
        'U_b = V_b·sgn i'
    """

    def __init__(self, kind: str, terms: Mapping[str, Term]) -> None:
        self._kind = kind
        self._terms: dict[str, Term] = {}
        for term in terms.values():
            self._terms.setdefault(term.name, term)

    def __getitem__(self, name: str) -> Term:
        if name not in self._terms:
            raise UnknownNameError(f"term of {self._kind}", str(name), self._terms)
        return self._terms[name]

    def __contains__(self, name: object) -> bool:
        return name in self._terms

    def __iter__(self) -> Iterator[str]:
        return iter(self._terms)

    def __len__(self) -> int:
        return len(self._terms)

    def __repr__(self) -> str:
        return text_of(self._renderables())

    def _repr_html_(self) -> str:
        return html_of(self._renderables())

    def to_pandas(self) -> Any:
        """Return a pandas DataFrame with a row for each term."""
        rows = self._terms.values()
        columns = {
            "enters": [term.enters.value for term in rows],
            "equation": [term.equation for term in rows],
            "parameters": [_parameters(term) for term in rows],
            "revealed_by": [term.revealed_by for term in rows],
            "source": [term.source for term in rows],
        }
        return data_frame(columns, index=list(self._terms), index_name="term")

    def _renderables(self) -> list[RenderableType]:
        from rich.table import Table

        table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
        table.add_column("term", no_wrap=True)
        table.add_column("enters", no_wrap=True)
        table.add_column("equation", max_width=48)
        table.add_column("parameters", max_width=40)
        table.add_column("source", max_width=24)
        for name, term in self._terms.items():
            table.add_row(name, term.enters.value, term.equation, _parameters(term), term.source)
        return [table]


def _parameters(term: Term) -> str:
    return ", ".join(f"{p.name.partition('.')[2]} [{p.unit}]" for p in term.parameters)


class Model:
    """The white-box model of a rig, with its known values. Made by :func:`labhil.model`. Immutable.

    Example:
        >>> import labhil as lh
        >>> model = lh.model("ball_beam", known={"ball_mass": 0.261})
        >>> model
        <Model of ball_beam, known: ball_mass>
        >>> model.baseline
        ('viscous_friction',)
        >>> model.terms["coulomb_friction"].parameters[0].unit
        'N'
    """

    def __init__(self, rig: RigFile) -> None:
        self._rig = rig

    @property
    def rig_file(self) -> RigFile:
        """The rig file of the model."""
        return self._rig

    @property
    def kind(self) -> str:
        """The rig kind."""
        return self._rig.kind.name

    @property
    def known(self) -> Mapping[str, Any]:
        """Known values of the rig by name, in SI units; all others are estimated."""
        return dict(self._rig.known)

    @property
    def nominal(self) -> Mapping[str, float]:
        """Values of the user's simulation, to which a diagnosis compares."""
        return dict(self._rig.nominal)

    @property
    def inputs(self) -> tuple[Signal, ...]:
        """Input signals."""
        return self._rig.kind.inputs

    @property
    def outputs(self) -> tuple[Signal, ...]:
        """Predicted signals."""
        return self._rig.kind.outputs

    @property
    def baseline(self) -> tuple[str, ...]:
        """The default baseline of :func:`labhil.diagnose`."""
        require_analysis("a model")
        from labhil.physics.rigs import rig_model

        return rig_model(self.kind).baseline

    @property
    def general(self) -> tuple[str, ...]:
        """The default terms of :func:`labhil.fit`."""
        require_analysis("a model")
        from labhil.physics.rigs import rig_model

        return rig_model(self.kind).general

    @cached_property
    def terms(self) -> Terms:
        """Every effect that the model may have; prints as a table."""
        require_analysis("a model")
        from labhil.physics.rigs import model_for

        return Terms(self.kind, model_for(self._rig).terms)

    def __repr__(self) -> str:
        known = f", known: {', '.join(self.known)}" if self.known else ""
        return f"<Model of {self.kind}{known}>"

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Model) and self._rig.model_dump() == other._rig.model_dump()

    def __hash__(self) -> int:
        return hash(self.kind)


def model(
    rig: PathLike | Model | RigFile | Recording,
    *,
    known: Mapping[str, object] | None = None,
    nominal: Mapping[str, float] | None = None,
    horizon: float | None = None,
) -> Model:
    """Make the model of a rig.

    Args:
        rig: A rig kind (``"ball_beam"``, ``"dc_motor"``, ``"solenoid"``, ``"axis"``, ``"ur5"``), the path of
            a rig file, or a recording with one.
        known: Known sizes of the rig by name, in SI units, or the path of a table (``links``, ``force_map``);
            they replace those in the rig file.
        nominal: Values of your simulation by parameter, for a diagnosis to compare with.
        horizon: Length of the simulated windows by which models are scored, s; by default that of the rig
            kind.

    Returns:
        The model; :attr:`Model.terms` is its catalogue.

    Raises:
        UsageError: There is no such rig kind and no such file.
        RigFileError: A name or a value is wrong for the rig kind.

    Example:
        >>> import labhil as lh
        >>> model = lh.model("dc_motor", known={"resistance": 2.1, "inductance": 1.5e-3})
        >>> model.general
        ('viscous_friction', 'coulomb_friction', 'stribeck_friction', 'quadratic_viscous_friction',
        'cubic_viscous_friction')
    """
    recording_model = getattr(rig, "model", None)
    if isinstance(recording_model, Model):
        base = recording_model.rig_file
    else:
        rig_from_argument = rig_file(rig)  # type: ignore[arg-type]
        if rig_from_argument is None:
            raise UsageError("rig: expected a rig kind, the path of a rig file or a recording, found None")
        base = rig_from_argument
    if known is None and nominal is None and horizon is None:
        return Model(base)
    data = base.model_dump(mode="json", exclude_defaults=True)
    data["rig"] = {"kind": base.kind.name}
    data["known"] = {**base.known, **{name: _plain(value) for name, value in (known or {}).items()}}
    data["nominal"] = {**base.nominal, **{name: float(value) for name, value in (nominal or {}).items()}}
    if horizon is not None:
        data["metric"] = {**data.get("metric", {}), "horizon": float(horizon)}
    files = {name: content for name, content in base.files.items() if name not in (known or {})}
    parsed = parse_rig(to_toml({name: part for name, part in data.items() if part}), base.path, files)
    tables = {name: parsed.known_file(name) for name, size in parsed.kind.known.items() if size.table}
    return Model(parsed.model_copy(update={"files": {k: file.content for k, file in tables.items() if file}}))


def _plain(value: object) -> object:
    """Return a value of ``[known]`` as a type of TOML."""
    if isinstance(value, (bool, str)) or value is None:
        return value
    if isinstance(value, (int, float, np.integer, np.floating)):
        return float(value)
    if isinstance(value, (list, tuple, np.ndarray)):
        return [float(item) for item in value]
    return str(value)
