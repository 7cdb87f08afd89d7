"""Sensors of the arm: from true quantities to the readings of the controller."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labhil.compiled import compiled
from labhil.plants.arm.effects import Values
from labhil.plants.arm.links import JOINTS
from labhil.signals import FloatArray


@dataclass(slots=True)
class Sensors:
    """Encoders, current, temperature and voltage sensors; ``state`` is that of the coloured current noise."""

    q_noise: float
    qd_noise: float
    gain: FloatArray
    offset: FloatArray
    current_noise: FloatArray
    memory: float
    current_resolution: float
    temperature_noise: float
    temperature_resolution: float
    supply: float
    supply_resistance: float
    voltage_noise: float
    random: np.random.Generator
    state: FloatArray

    @classmethod
    def of(cls, values: Values, random: np.random.Generator) -> Sensors:
        """Take them from the parameters of a plant; ``random`` generates all noise."""
        return cls(
            q_noise=values.number("q_noise"),
            qd_noise=values.number("qd_noise"),
            gain=1.0 + values.per_joint("sensor_gain.gain"),
            offset=values.per_joint("sensor_offset.offset"),
            current_noise=values.per_joint("current_noise"),
            memory=values.number("current_noise_memory"),
            current_resolution=values.number("current_resolution"),
            temperature_noise=values.number("temperature_noise"),
            temperature_resolution=values.number("temperature_resolution"),
            supply=values.number("supply_voltage"),
            supply_resistance=values.number("supply_resistance"),
            voltage_noise=values.number("voltage_noise"),
            random=random,
            state=random.standard_normal(JOINTS),
        )

    def angles(self, q: FloatArray) -> FloatArray:
        """Measure angles (n, 6) rad."""
        return q + self.q_noise * self.random.standard_normal(q.shape)

    def velocities(self, qd: FloatArray) -> FloatArray:
        """Measure velocities (n, 6) rad/s."""
        return qd + self.qd_noise * self.random.standard_normal(qd.shape)

    def currents(self, current: FloatArray) -> FloatArray:
        """Measure currents (n, 6) A, with coloured noise."""
        noise = self.random.standard_normal(current.shape)
        colour(noise, self.memory, self.state)
        return round_to(
            self.gain * current + self.offset + self.current_noise * noise, self.current_resolution
        )

    def temperatures(self, temperature: FloatArray) -> FloatArray:
        """Measure temperatures (n, 6) °C."""
        noise = self.temperature_noise * self.random.standard_normal(temperature.shape)
        return round_to(temperature + noise, self.temperature_resolution)

    def voltage(self, power: FloatArray) -> FloatArray:
        """Measure the voltage (n,) of the supply under a power (n,) W; returned power does not raise it."""
        sag = self.supply_resistance * np.maximum(power, 0.0) / self.supply
        return np.asarray(self.supply - sag + self.voltage_noise * self.random.standard_normal(power.shape))


def round_to(values: FloatArray, resolution: float) -> FloatArray:
    """Round to whole steps of ``resolution``; 0 leaves the values as they are."""
    return values if resolution == 0.0 else np.rint(values / resolution) * resolution


@compiled
def colour(noise: FloatArray, memory: float, state: FloatArray) -> None:
    """Turn white noise (n, 6) of unit variance into a first-order process of the same variance, in place."""
    innovation = (1.0 - memory * memory) ** 0.5
    for i in range(noise.shape[0]):
        for j in range(noise.shape[1]):
            state[j] = memory * state[j] + innovation * noise[i, j]
            noise[i, j] = state[j]
