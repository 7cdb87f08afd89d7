"""Containers opened, spoilt inside, and closed again with every checksum and length right."""

from __future__ import annotations

import json
import sqlite3
import struct
import tempfile
import zipfile
import zlib
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from random import Random

import lz4.frame
import zstandard

from labhil_benchmarks.bad_files.spoil import spoil_bytes, spoil_text, spoil_tree

MAGIC = b"\x89MCAP0\r\n"
HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, ATTACHMENT, METADATA = 1, 2, 3, 4, 5, 6, 9, 12
_HEAD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")
_STAMPS = (0, 1, 2**32 - 1, 2**62, 2**63 - 1, 2**63, 2**64 - 1, 10**18)

Records = list[tuple[int, bytes]]


def spoil_mcap(data: bytes, draw: Random) -> bytes:
    """Return an MCAP file with one to three records spoilt inside; chunks get their right checksum."""
    records = [inner for opcode, body in _records(data[len(MAGIC) :]) for inner in _unpack(opcode, body)]
    kept = [
        entry for entry in records if entry[0] in (HEADER, SCHEMA, CHANNEL, MESSAGE, ATTACHMENT, METADATA)
    ]
    for _ in range(draw.choice((1, 1, 2, 3))):
        # by kind first: there are many messages and few descriptions
        opcode = draw.choice(sorted({entry[0] for entry in kept}))
        place = draw.choice([k for k, entry in enumerate(kept) if entry[0] == opcode])
        what = draw.randrange(12)
        if what == 0:
            kept.insert(draw.randrange(len(kept)), kept[place])
        elif what == 1 and len(kept) > 2:
            kept.insert(draw.randrange(len(kept) - 1), kept.pop(place))
        else:
            kept[place] = (opcode, _spoil_record(opcode, kept[place][1], draw))
    return pack_mcap(kept, draw.choice(("", "lz4", "zstd")), draw.choice((1, 4)))


def pack_mcap(records: Records, packing: str, chunks: int) -> bytes:
    """Return an MCAP file of these records; those that may stand in chunks are in this many."""
    outside = [entry for entry in records if entry[0] in (HEADER, ATTACHMENT, METADATA)]
    inside = [entry for entry in records if entry[0] not in (HEADER, ATTACHMENT, METADATA)]
    size = -(-len(inside) // chunks) or 1
    body = b"".join(record(*entry) for entry in outside[:1])
    for first in range(0, len(inside), size):
        body += record(
            CHUNK, chunk(b"".join(record(*entry) for entry in inside[first : first + size]), packing)
        )
    body += b"".join(record(*entry) for entry in outside[1:])
    return MAGIC + body + record(15, bytes(4)) + record(FOOTER, bytes(20)) + MAGIC


def record(opcode: int, body: bytes) -> bytes:
    """Return a record with its length."""
    return _HEAD.pack(opcode, len(body)) + body


def chunk(content: bytes, packing: str, claimed: int | None = None) -> bytes:
    """Return the body of a chunk with its right checksum; ``claimed`` is a size that it only claims."""
    pack = {"": bytes, "lz4": lz4.frame.compress, "zstd": zstandard.ZstdCompressor().compress}
    packed = pack[packing](content)
    name = packing.encode()
    size = len(content) if claimed is None else claimed
    head = struct.pack("<QQQI", 0, 2**62, size, zlib.crc32(content))
    return head + struct.pack("<I", len(name)) + name + struct.pack("<Q", len(packed)) + packed


def _records(data: bytes) -> Iterator[tuple[int, bytes]]:
    position = 0
    while position + _HEAD.size <= len(data):
        opcode, length = _HEAD.unpack_from(data, position)
        position += _HEAD.size + length
        if opcode == FOOTER or position > len(data):
            return
        yield opcode, data[position - length : position]


def _unpack(opcode: int, body: bytes) -> Iterator[tuple[int, bytes]]:
    """The records of a chunk; any other record by itself."""
    if opcode != CHUNK:
        yield opcode, body
        return
    (named,) = struct.unpack_from("<I", body, 28)
    name, packed = body[32 : 32 + named], body[40 + named :]
    unpack = {b"": bytes, b"lz4": lz4.frame.decompress, b"zstd": zstandard.ZstdDecompressor().decompress}
    yield from _records(unpack[name](packed))


def _spoil_record(opcode: int, body: bytes, draw: Random) -> bytes:
    if opcode == MESSAGE and draw.randrange(2):
        head = list(_MESSAGE.unpack_from(body))
        place = draw.randrange(4)
        limit = (2**16, 2**32, 2**64, 2**64)[place]
        head[place] = draw.choice(_STAMPS) % limit
        return _MESSAGE.pack(*head) + body[_MESSAGE.size :]
    if opcode == MESSAGE and len(body) > _MESSAGE.size:
        return body[: _MESSAGE.size] + spoil_bytes(body[_MESSAGE.size :], draw)
    if opcode == CHANNEL and draw.randrange(3):
        return _spoil_channel(body, draw)
    if opcode == ATTACHMENT:
        return _spoil_attachment(body, draw)
    return spoil_bytes(body, draw)


def _texts(data: bytes, position: int, count: int) -> tuple[list[bytes], int]:
    texts = []
    for _ in range(count):
        (size,) = struct.unpack_from("<I", data, position)
        texts.append(data[position + 4 : position + 4 + size])
        position += 4 + size
    return texts, position


def _text(content: bytes) -> bytes:
    return struct.pack("<I", len(content)) + content


def _spoil_channel(body: bytes, draw: Random) -> bytes:
    """Topic, encoding, or the declaration of the stream in a channel's metadata."""
    names, position = _texts(body, 4, 2)
    pairs, end = [], position + 4
    while end < len(body):
        pair, end = _texts(body, end, 2)
        pairs.append(pair)
    what = draw.randrange(4) if pairs else 0
    if what == 0:
        k = draw.randrange(2)
        names[k] = spoil_text(names[k].decode(), draw).encode("utf-8", "replace")
    else:
        pair = draw.choice(pairs)
        try:
            pair[1] = json.dumps(spoil_tree(json.loads(pair[1]), draw)).encode()
        except (ValueError, AttributeError, TypeError):
            pair[1] = spoil_text(pair[1].decode(), draw).encode("utf-8", "replace")
    inside = b"".join(_text(part) for pair in pairs for part in pair)
    return body[:4] + b"".join(map(_text, names)) + _text(inside)


def _spoil_attachment(body: bytes, draw: Random) -> bytes:
    """Its name or its content, with its right checksum."""
    names, position = _texts(body, 16, 2)
    content = body[position + 8 : -4]
    if draw.randrange(4):
        content = spoil_text(content.decode("utf-8", "replace"), draw).encode("utf-8", "replace")
    else:
        names[0] = spoil_text(names[0].decode(), draw).encode("utf-8", "replace")
    whole = body[:16] + b"".join(map(_text, names)) + struct.pack("<Q", len(content)) + content
    return whole + struct.pack("<I", zlib.crc32(whole))


def spoil_zip(data: bytes, draw: Random, suffix: str = ".xml") -> bytes:
    """Return a ZIP file with one of its texts spoilt and packed again."""
    out = BytesIO()
    with zipfile.ZipFile(BytesIO(data)) as packed, zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as new:
        names = packed.namelist()
        chosen = draw.choice([name for name in names if name.endswith(suffix)])
        for name in names:
            content = packed.read(name)
            if name == chosen:
                content = spoil_text(content.decode(), draw).encode("utf-8", "replace")
            new.writestr(name, content)
    return out.getvalue()


def spoil_mat(data: bytes, draw: Random) -> bytes:
    """Return a packed MAT file of version 5 with one of its elements spoilt inside and packed again."""
    elements, position = [], 128
    while position + 8 <= len(data):
        kind, size = struct.unpack_from("<II", data, position)
        elements.append((kind, data[position + 8 : position + 8 + size]))
        position += 8 + size
    place = draw.randrange(len(elements))
    kind, body = elements[place]
    if kind == 15:
        body = zlib.compress(spoil_bytes(zlib.decompress(body), draw))
    elements[place] = (kind, body)
    return data[:128] + b"".join(struct.pack("<II", kind, len(body)) + body for kind, body in elements)


def spoil_database(data: bytes, draw: Random) -> bytes:
    """Return a bag's SQLite file with one of its cells changed by SQLite itself."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.db3"
        path.write_bytes(data)
        database = sqlite3.connect(path)
        tables = [
            row[0] for row in database.execute("select name from sqlite_master where type='table'").fetchall()
        ]
        table = draw.choice([name for name in tables if not name.startswith("sqlite")])
        columns = [row[1] for row in database.execute(f'pragma table_info("{table}")').fetchall()]
        column = draw.choice(columns)
        rows = [row[0] for row in database.execute(f'select rowid from "{table}"').fetchall()]
        if rows:
            row = draw.choice(rows)
            old = database.execute(f'select "{column}" from "{table}" where rowid={row}').fetchone()[0]
            new = (
                spoil_bytes(old, draw)
                if isinstance(old, bytes)
                else draw.choice((None, -1, 2**63 - 1, 1e308, "", b"\xff", spoil_text(str(old), draw)))
            )
            try:
                database.execute(f'update "{table}" set "{column}"=? where rowid={row}', (new,))
                database.commit()
            except sqlite3.Error:
                database.rollback()
        database.close()
        return path.read_bytes()


def rename_device(data: bytes, name: str) -> bytes:
    """Return an MCAP file with a name for its device, for its signals' units, and for its attachments."""
    records = [inner for opcode, body in _records(data[len(MAGIC) :]) for inner in _unpack(opcode, body)]
    kept = []
    for opcode, body in records:
        if opcode == CHANNEL:
            names, position = _texts(body, 4, 2)
            pairs, end = [], position + 4
            while end < len(body):
                pair, end = _texts(body, end, 2)
                pairs.append(pair)
            changed = [[key, _rename_stream(value, name)] for key, value in pairs if key != b"device"]
            metadata = b"".join(
                _text(part) for pair in [*changed, [b"device", name.encode()]] for part in pair
            )
            kept.append(
                (opcode, body[:4] + _text(f"/{name}/state".encode()) + _text(names[1]) + _text(metadata))
            )
        elif opcode in (HEADER, SCHEMA, MESSAGE, METADATA):
            kept.append((opcode, body))
    return pack_mcap(kept, "lz4", 1)


def _rename_stream(value: bytes, name: str) -> bytes:
    try:
        tree = json.loads(value)
    except ValueError:
        return value
    if isinstance(tree, dict):
        for signal in tree.get("signals", []):
            signal["unit"] = name
    return json.dumps(tree).encode()
