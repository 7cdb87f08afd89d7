"""The text of an experiment file that several tests begin with."""


def held_voltage(name: str, level: float = 3.0, duration: float = 2.0) -> str:
    """Return an experiment that holds the voltage of a simulated motor.

    Args:
        name: Its name.
        level: Voltage, V.
        duration: Length of its only step, s.
    """
    return f"""
[experiment]
name = "{name}"
[devices.bench]
plugin = "dc_motor"
address = "twin"
[[steps]]
device = "bench"
signal = "voltage"
excitation = "hold"
level = {level}
duration = {duration}
"""
