"""Recordings that are larger than what is kept in memory: the same numbers, from a temporary file."""

from __future__ import annotations

import errno
import mmap
from pathlib import Path

import numpy as np
import pytest

from labhil.errors import DiskFailedError
from labhil.recording import chunks, memory_maps, message_store, samples
from labhil.recording.export import export
from labhil.recording.message_store import Message, MessageStore
from labhil.recording.reader import read_recording
from labhil.recording.recover import recover
from labhil_benchmarks.large_recording import STREAM, write_large

SAMPLES = 30_000


@pytest.fixture
def everything_is_large(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a file of some megabytes count as large in every respect."""
    monkeypatch.setattr(memory_maps, "MIN_MAPPED_SIZE", 1)
    monkeypatch.setattr(memory_maps, "BLOCK_ROWS", 1000)
    monkeypatch.setattr(chunks, "RELEASE_INTERVAL", 1 << 18)
    monkeypatch.setattr(chunks, "BLOCK_SIZE", 1 << 18)
    monkeypatch.setattr(samples, "MAX_BYTES_IN_MEMORY", 1 << 20)
    monkeypatch.setattr(message_store, "MAX_BYTES_IN_MEMORY", 1 << 20)


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_large(tmp_path_factory.mktemp("large") / "a.mcap", SAMPLES)


def test_a_large_recording_is_read_as_a_small_one_is(path: Path, request: pytest.FixtureRequest) -> None:
    small = read_recording(path)
    request.getfixturevalue("everything_is_large")
    large = read_recording(path)
    assert large.sha256 == small.sha256
    assert large.events == small.events and len(large.events) == SAMPLES // 10_000
    (one,), (other,) = small.streams, large.streams
    held = other.values
    while isinstance(held, np.ndarray):
        held = held.base
    assert isinstance(getattr(held, "obj", held), mmap.mmap), "the values are in memory"
    for name in ("seq", "t_acq_ns", "t_hw_ns", "values", "t"):
        assert np.array_equal(getattr(one, name), getattr(other, name)), name


@pytest.mark.extended
@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_a_large_recording_is_exported_as_a_small_one_is(
    path: Path, tmp_path: Path, request: pytest.FixtureRequest, suffix: str
) -> None:
    small = export(read_recording(path), tmp_path / f"small{suffix}")
    request.getfixturevalue("everything_is_large")
    large = export(read_recording(path), tmp_path / f"large{suffix}")
    assert large.read_bytes() == small.read_bytes()


@pytest.mark.extended
def test_a_large_broken_recording_is_recovered_to_the_last_whole_message(
    path: Path, tmp_path: Path, everything_is_large: None
) -> None:
    cut = tmp_path / "cut.mcap.part"
    cut.write_bytes(path.read_bytes()[: path.stat().st_size * 9 // 10])
    told = recover(cut, tmp_path / "saved.mcap")
    whole, saved = read_recording(path), read_recording(tmp_path / "saved.mcap")
    assert saved.complete and not told.ended
    count = len(saved.streams[0])
    assert SAMPLES * 8 // 10 < count < SAMPLES
    assert np.array_equal(saved.streams[0].values, whole.streams[0].values[:count])
    assert np.array_equal(saved.streams[0].t_hw_ns, whole.streams[0].t_hw_ns[:count])


def test_messages_come_back_from_memory_and_from_the_disk(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(message_store, "MAX_BYTES_IN_MEMORY", 2000)
    store = MessageStore()
    meant = [Message(k % 3, k, 10 * k, 10 * k + 1, bytes([k]) * (k % 50)) for k in range(200)]
    for message in meant:
        store.append(message)
        assert store[-1] == message
    assert list(store) == meant and store[5:8] == meant[5:8]
    assert store.pop(150) == meant.pop(150)
    assert list(store) == meant


def test_without_room_for_a_temporary_file_it_is_said_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TMPDIR", "/dev/full")
    monkeypatch.setattr("tempfile.tempdir", None)

    def full(**_where: str | None) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("tempfile.TemporaryFile", full)
    with pytest.raises(DiskFailedError, match=r"No space left on device.*TMPDIR"):
        memory_maps.Spool(len(STREAM.signals))
