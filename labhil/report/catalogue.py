"""The catalogue of terms of each rig kind, as text and as JSON (``labhil terms``)."""

from __future__ import annotations

from typing import Any

from labhil.kinds import kind_named, kind_names
from labhil.physics.friction_law import LABHIL, provider
from labhil.physics.rigs import model_for, rig_model
from labhil.physics.terms import Term
from labhil.rig import default_rig
from labhil.terminal import terminal


def terms_by_rig(kind: str | None) -> dict[str, dict[str, Term]]:
    """Return the terms of one rig kind, or of all.

    Args:
        kind: Name of a rig kind; None for all.

    Raises:
        UnknownNameError: There is no such kind.
    """
    kinds = [kind_named(kind).name] if kind else list(kind_names())
    catalogues = {}
    for name in kinds:
        rig = default_rig(name)
        catalogues[name] = dict(model_for(rig).terms)
    return catalogues


def catalogue_json(kind: str | None) -> dict[str, Any]:
    """Return the catalogue of one rig kind, or of all, as plain JSON data."""
    rigs = {
        rig: {
            "baseline": list(rig_model(rig).baseline),
            "general": list(rig_model(rig).general),
            "terms": [_term_json(term) for term in terms.values()],
        }
        for rig, terms in terms_by_rig(kind).items()
    }
    return {"schema": "labhil.terms/1", "rigs": rigs}


def _term_json(term: Term) -> dict[str, Any]:
    return {
        "term": term.name,
        "enters": term.enters.value,
        "statement": term.statement,
        "equation": term.equation,
        "source": term.source,
        "provider": provider(term.name),
        "revealed_by": term.revealed_by,
        "needs": list(term.needs),
        "parameters": [{"name": p.name, "unit": p.unit, "neutral": p.neutral} for p in term.parameters],
        "known": [{"name": p.name, "unit": p.unit, "value": p.scale} for p in term.known],
    }


def show_catalogue(kind: str | None) -> None:
    """Print the catalogue of one rig kind, or of all."""
    console = terminal(highlight=False)
    for rig, terms in terms_by_rig(kind).items():
        console.print(f"[bold]{rig}[/bold]  baseline: {', '.join(rig_model(rig).baseline)}", markup=True)
        for term in terms.values():
            console.print(f"\n[bold]{term.name}[/bold] ({term.enters.value}): {term.statement}", markup=True)
            by = provider(term.name)
            console.print(f"  {term.equation}   — {term.source}" + (f" ({by})" if by != LABHIL else ""))
            units = ", ".join(f"{p.name} [{p.unit}]" for p in term.parameters)
            units += "".join(f"; {p.name} = {p.scale:g} [known]" for p in term.known)
            console.print(f"  {units}; revealed by {term.revealed_by}")
