"""All cases of chapter 5, by name and by the numbers of their tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from labhil.errors import UnknownNameError
from labhil_benchmarks.reference.arm import ARM
from labhil_benchmarks.reference.ball import BALL_AND_BEAM
from labhil_benchmarks.reference.motor import MOTOR
from labhil_benchmarks.reference.plunger import SOLENOID
from labhil_benchmarks.reference.published import NUMBERS
from labhil_benchmarks.reference.study import Study

STUDIES: Mapping[str, Study] = {study.name: study for study in (*MOTOR, SOLENOID, *BALL_AND_BEAM, ARM)}


def studies_of(tables: Sequence[str]) -> tuple[Study, ...]:
    """The cases that fill these tables; UnknownNameError lists the numbers that there are."""
    for number in tables:
        if number not in NUMBERS:
            raise UnknownNameError("table of chapter 5", number, NUMBERS)
    return tuple(study for study in STUDIES.values() if set(study.numbers) & set(tables))
