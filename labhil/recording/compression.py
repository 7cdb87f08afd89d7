"""The content of a chunk, unpacked, never more of it than the chunk says."""

from __future__ import annotations

from typing import Any

import lz4.frame
import zstandard


def decompress(compression: str, content: bytes, size: int) -> bytes:
    """Return the content of a chunk; at most ``size`` bytes and one more are ever made.

    Args:
        compression: ``"lz4"``, ``"zstd"`` or ``""``.
        content: The packed bytes.
        size: How many bytes the chunk says that they make.

    Raises:
        ValueError: The content makes more, or the compression is none of these.
        Exception: What lz4 and zstandard raise on content that is damaged.
    """
    if compression == "":
        return content
    if compression == "zstd":
        # zstandard makes room for what the frame claims, whatever limit it is given
        claimed = zstandard.frame_content_size(content)
        if claimed > size:
            raise ValueError(f"its zstd frame claims {claimed} bytes, the chunk {size}")
        return zstandard.ZstdDecompressor().decompress(content, max_output_size=max(size, 1))
    if compression == "lz4":
        return _unpack_lz4(content, size)
    raise ValueError(f"expected the compression lz4, zstd or none, found {compression!r:.40}")


def decompress_prefix(compression: str, content: bytes, size: int) -> bytes:
    """As much as can be had of content that is cut off, at most ``size`` bytes; empty when it is damaged."""
    if compression == "":
        return content[:size]
    try:
        if compression == "lz4":
            return bytes(lz4.frame.LZ4FrameDecompressor().decompress(content, max_length=size))
        reader = zstandard.ZstdDecompressor().stream_reader(content)
        return _read(reader, size)
    except Exception:  # noqa: BLE001 - each library raises its own
        return b""


def _unpack_lz4(content: bytes, size: int) -> bytes:
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
