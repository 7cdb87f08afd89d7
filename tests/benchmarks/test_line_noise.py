"""Noise on a line, some of each kind; ``measure_line_noise.py`` makes ten million bytes."""

from __future__ import annotations

import pytest

from labhil.link import Frame
from labhil_benchmarks import line_noise
from labhil_benchmarks.line_noise import (
    DAMAGE,
    Heard,
    forged_frames,
    noisy_frames,
    random_bytes,
    rtde_packages,
)

BYTES = 200_000


@pytest.mark.parametrize("name", DAMAGE)
def test_damaged_frames_are_refused_and_the_second_after_them_is_heard(name: str) -> None:
    heard = noisy_frames(BYTES, DAMAGE[name], seed=3)
    assert (heard.faults, heard.wrong) == ([], 0)
    assert heard.longest_miss <= 1
    assert heard.refused > 500
    assert heard.received >= heard.whole - heard.missed > 2000


def test_bytes_at_random_are_refused_and_the_second_frame_after_them_is_heard() -> None:
    heard = random_bytes(BYTES, seed=3)
    assert (heard.faults, heard.wrong) == ([], 0)
    assert heard.longest_miss <= 1
    assert heard.whole == heard.received + heard.missed


def test_payloads_at_random_are_read_or_refused() -> None:
    heard = forged_frames(BYTES, seed=3)
    assert heard.faults == []
    assert min(heard.received, heard.refused) > 1000


def test_damaged_packages_of_rtde_are_read_or_refused() -> None:
    heard = rtde_packages(BYTES, seed=3)
    assert heard.faults == []
    assert min(heard.received, heard.refused) > 100


def test_a_decoder_that_raises_or_takes_what_was_not_sent_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    class Careless(line_noise.Decoder):
        def feed(self, data: bytes) -> list[Frame]:
            found = super().feed(data)
            if len(data) > 250:
                raise ValueError(data)
            return [Frame(frame.type, frame.seq + 1, frame.t_us, frame.payload) for frame in found]

    monkeypatch.setattr(line_noise, "Decoder", Careless)
    heard: Heard = noisy_frames(BYTES, DAMAGE["bytes inserted"], seed=3)
    assert heard.wrong > 1000
    assert heard.longest_miss > 1
    assert "ValueError" in heard.faults[0]
