"""Whether a recording moves as its simulator does under the same input: the same way, and about as far.

The inertia that a recording shows comes from a regression of the balance of forces, before any fit
(``physics.weak_form``). Another sign of it is another sign of the input or of the motion; one that is ten
times larger or smaller than the simulator's is more than a wrong value.
"""

from __future__ import annotations

from labhil.physics.weak_form import MassAndDrag


def disagreement_note(
    measured: MassAndDrag,
    gain: float,
    names: tuple[str, str, str],
    *,
    min_mass_in_errors: float = 10.0,
    max_factor: float = 10.0,
) -> str:
    """State a sign or a unit that differs between a recording and a simulator.

    Args:
        measured: Inertia that the recording shows, in units of the input.
        gain: Acceleration of the simulator per unit of the input.
        names: Of the output, the input and the simulator.
        min_mass_in_errors: Standard errors by which that inertia has to differ from zero.
        max_factor: Ratio of both inertias from which units are in doubt.

    Returns:
        The note; empty where both agree, or nothing can be said.
    """
    if abs(measured.mass) <= min_mass_in_errors * measured.mass_error or not gain:
        return ""
    (output, signal, simulator), ratio = names, measured.mass * gain
    same = f"that of {simulator} under the same {signal}"
    if ratio < 0.0:
        return (
            f"{output} moves the other way than {same}: one of the two has the other sign in the recording "
            "(scale = -1 under [channels]), or in the simulator."
        )
    if 1.0 / max_factor < ratio < max_factor:
        return ""
    return (
        f"{output} moves {1.0 / ratio:.3g} times as far as {same}: is the unit of one of them another one in "
        "the recording? Degrees for radians make 57.3, milli-units 1000."
    )
