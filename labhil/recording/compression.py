"""Decompression of chunks, limited to the size that a chunk states."""

from __future__ import annotations

from typing import Any

import lz4.frame
import zstandard


def decompress(compression: str, content: bytes, size: int) -> bytes:
    """Decompress the content of a chunk, with at most ``size`` + 1 bytes of memory.

    Args:
        compression: ``"lz4"``, ``"zstd"`` or ``""``.
        content: the compressed bytes.
        size: their decompressed size by the chunk.

    Returns:
        The decompressed bytes.

    Raises:
        ValueError: The decompressed size is larger, or the compression is unknown.
        Exception: lz4 and zstandard have their own errors for damaged content.
    """
    if compression == "":
        return content
    if compression == "zstd":
        # zstandard allocates the size that the frame claims, whatever its limit
        claimed = zstandard.frame_content_size(content)
        if claimed > size:
            raise ValueError(f"its zstd frame claims {claimed} bytes, the chunk {size}")
        return zstandard.ZstdDecompressor().decompress(content, max_output_size=max(size, 1))
    if compression == "lz4":
        return _decompress_lz4(content, size)
    raise ValueError(f"expected the compression lz4, zstd or none, found {compression!r:.40}")


def decompress_prefix(compression: str, content: bytes, size: int) -> bytes:
    """Decompress the begin of truncated content, at most ``size`` bytes; empty if it is damaged."""
    if compression == "":
        return content[:size]
    try:
        if compression == "lz4":
            return bytes(lz4.frame.LZ4FrameDecompressor().decompress(content, max_length=size))
        reader = zstandard.ZstdDecompressor().stream_reader(content)
        return _read(reader, size)
    except Exception:  # noqa: BLE001 - each library raises its own
        return b""


def _decompress_lz4(content: bytes, size: int) -> bytes:
    packer = lz4.frame.LZ4FrameDecompressor()
    raw = bytes(packer.decompress(content, max_length=size + 1))
    if len(raw) > size:
        raise ValueError(f"its lz4 frame makes more than the {size} bytes that the chunk claims")
    if not packer.eof:
        raise ValueError("its lz4 frame has no end")
    return raw


def _read(reader: Any, size: int) -> bytes:
    pieces: list[bytes] = []
    while size > 0:
        try:
            piece = reader.read(min(size, 1 << 20))
        except zstandard.ZstdError:
            break
        if not piece:
            break
        pieces.append(piece)
        size -= len(piece)
    return b"".join(pieces)
