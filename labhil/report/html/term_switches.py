"""The final model of a diagnosis over the measurement, whole and without each found term, with switches."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from labhil.diagnose.locate import HeldOut, without_sizes
from labhil.errors import RecordingError
from labhil.identify.fitted import Fitted
from labhil.identify.score import Score, score
from labhil.identify.windows import noise_of
from labhil.physics.model import Metric
from labhil.report.html.element import Markup, join, tag
from labhil.report.html.overlay import COLOURS, Overlaid, overlay
from labhil.report.html.picture import Album

MOST_TERMS = len(COLOURS) - 2
"""Found terms that have a switch, beside the whole model and the baseline."""


def term_switches(final: Fitted, terms: Sequence[str], held_out: HeldOut, album: Album) -> Markup | None:
    """Draw held-out data, the final model, the baseline, and the final model without each found term.

    Args:
        final: The fit of the final model.
        terms: Keys of the found terms.
        held_out: The held-out data with the scores of baseline and final model.
        album: The pictures of the page.

    Returns:
        The legend with switches and the pictures; None where nothing with a name was found, or nothing is
        simulated.
    """
    if not terms or held_out.after.metric is Metric.INVERSE_DYNAMICS:
        return None
    lines: list[tuple[str, Score | None]] = [
        ("with all that was found", held_out.after),
        ("baseline", held_out.before),
    ]
    lines += [(f"without {term}", _without(final, term, held_out)) for term in terms[:MOST_TERMS]]
    drawn = [(name, each) for name, each in lines if each is not None and _same_rows(each, held_out.after)]
    names, scores = zip(*drawn, strict=True)
    introduction = tag(
        "p",
        "Each found term taken out of the final model, with all other values as they are: what the term "
        "does is the difference to the whole model. A click on a name switches its line off and on.",
    )
    return join((introduction, overlay(names, [Overlaid("", held_out.record, scores)], album)))


def _without(final: Fitted, term: str, held_out: HeldOut) -> Score | None:
    """Return the score of the final model without a term; None where it cannot be simulated so."""
    model, record = final.problem.model, held_out.record
    reduced = without_sizes(model, final.theta, term)
    try:
        return score(model, reduced, record, noise_of(record), windows=held_out.after.windows)
    except RecordingError:
        return None


def _same_rows(one: Score, other: Score) -> bool:
    return np.array_equal(one.rows, other.rows)
