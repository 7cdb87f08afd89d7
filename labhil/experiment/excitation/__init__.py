"""Excitation signals: functions of the time since a step began, by name, with their spectra.

No excitation is filtered or shaped: a device is requested to follow these values exactly, and the rate limit
of its rig file, which is recorded, keeps it from jumping. Nothing here depends on a device or the bus;
:func:`sample` evaluates any excitation at given times. Begin with ``make.py``, which lists them.
"""

from __future__ import annotations

from labhil.experiment.excitation.fourier import FourierSeries, evaluate_motion, fourier
from labhil.experiment.excitation.function import (
    Excitation,
    Excitations,
    columns_of,
    crest_factor,
    sample,
    sample_at_rate,
)
from labhil.experiment.excitation.levels import Hold, Steps, hold, prms, staircase, steps
from labhil.experiment.excitation.make import EXCITATIONS, ExcitationKeys, make_excitation
from labhil.experiment.excitation.phases import low_crest_phases, schroeder_phases
from labhil.experiment.excitation.shift_register import maximum_length_sequence, prbs
from labhil.experiment.excitation.spectrum import Band, Spectrum, spectrum_of
from labhil.experiment.excitation.table import Table, read_table
from labhil.experiment.excitation.tones import Chirp, Tones, chirp, multisine, two_sine

__all__ = [
    "EXCITATIONS",
    "Band",
    "Chirp",
    "Excitation",
    "ExcitationKeys",
    "Excitations",
    "FourierSeries",
    "Hold",
    "Spectrum",
    "Steps",
    "Table",
    "Tones",
    "chirp",
    "columns_of",
    "crest_factor",
    "evaluate_motion",
    "fourier",
    "hold",
    "low_crest_phases",
    "make_excitation",
    "maximum_length_sequence",
    "multisine",
    "prbs",
    "prms",
    "read_table",
    "sample",
    "sample_at_rate",
    "schroeder_phases",
    "spectrum_of",
    "staircase",
    "steps",
    "two_sine",
]
