"""Black-box baselines with which a white-box model is compared, from ARX to polynomial NARX.

Each is fitted to one input and one output, sampled evenly, and is scored by its free-run simulation.
``fit_linear`` fits one, ``linear_study`` all of them on a recording.
"""

from __future__ import annotations

from labhil.identify.linear.baselines import BASELINES, Baseline, fit_linear
from labhil.identify.linear.data import Figures, LinearModel, Orders, Sampled, figures_of
from labhil.identify.linear.study import LinearRow, linear_study, study_json, study_text

__all__ = [
    "BASELINES",
    "Baseline",
    "Figures",
    "LinearModel",
    "LinearRow",
    "Orders",
    "Sampled",
    "figures_of",
    "fit_linear",
    "linear_study",
    "study_json",
    "study_text",
]
