"""Envelopes: an answer and a nonce of 256 bits, with a seal: their SHA-256, which is published beforehand."""

from __future__ import annotations

import hashlib
import json
import secrets
from pathlib import Path
from typing import Any

from labhil.documents import parse_json, read_document
from labhil.errors import UsageError
from labhil.recording.memory_maps import sha256_of_file

NONCE_BYTES = 32


def seal(answer: Any, nonce: bytes) -> str:
    """Return the SHA-256 (hex) of the nonce and the answer as JSON with sorted keys and without spaces."""
    text = json.dumps(answer, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False)
    return hashlib.sha256(nonce + text.encode()).hexdigest()


def write_envelope(answer: Any, path: Path, nonce: bytes | None = None) -> str:
    """Write the answer and its nonce (default: from the system's randomness), and return the seal."""
    drawn = secrets.token_bytes(NONCE_BYTES) if nonce is None else nonce
    text = json.dumps({"nonce": drawn.hex(), "answer": answer}, ensure_ascii=False, allow_nan=False, indent=1)
    path.write_text(text + "\n", encoding="utf-8")
    return seal(answer, drawn)


def open_envelope(path: Path, expected: str) -> Any:
    """Read the answer in an envelope.

    Raises:
        UsageError: the file is no envelope, or its seal is not the expected one.
    """
    try:
        data = parse_json(read_document(path))
        nonce, answer = bytes.fromhex(data["nonce"]), data["answer"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise UsageError(f"{path}: expected a sealed answer (JSON with nonce and answer): {error}") from error
    actual = seal(answer, nonce)
    if actual != expected:
        raise UsageError(f"{path}: the seal does not match: expected SHA-256 {expected}, found {actual}")
    return answer


def sha256_of(path: Path) -> str:
    """Return the SHA-256 (hex) of a file.

    Raises:
        UsageError: the file cannot be read.
    """
    try:
        return sha256_of_file(path)
    except OSError as error:
        raise UsageError(f"{path}: cannot be read: {error.strerror}") from error
