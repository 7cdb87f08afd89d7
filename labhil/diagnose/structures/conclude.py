"""What a search over structures ends in: named terms or a curve, with scores on held-out data."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from labhil.diagnose.conclude import Concluded, HeldOutScores, concluded, leaves_more
from labhil.diagnose.found import Found
from labhil.diagnose.judge import Data
from labhil.diagnose.unmodelled import stated
from labhil.signals import FloatArray


def conclude(data: Data, found: Found, left: FloatArray, progress: Callable[[str], None]) -> Concluded:
    """Score what was found on held-out data, before and after on the same windows and of the same noise."""
    if not data.model.state_names:  # of inverse dynamics every joint has its own curve, by linear algebra
        return concluded(data, found, left, progress)
    progress("scores, intervals and exclusion limits")
    marked = HeldOutScores.of(data, found)
    more = leaves_more(data, found, left, marked.after.excess)
    curves = () if found.curve is None else (stated(data, found.curve),)
    end = Concluded(data, found, curves, more, marked.before, marked.after, marked.sigma)
    return replace(end, after=marked.of_model(*end.accepted)) if curves else end
