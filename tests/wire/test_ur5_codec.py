"""RTDE's packages: whatever is packed comes back, however the bytes are cut."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from labhil_sim_ur5.codec import FORMATS, WIDTHS, FramingError, PackageParser, Recipe, package

NUMBERS = {
    "BOOL": st.booleans(),
    "UINT8": st.integers(0, 2**8 - 1),
    "UINT32": st.integers(0, 2**32 - 1),
    "UINT64": st.integers(0, 2**64 - 1),
    "INT32": st.integers(-(2**31), 2**31 - 1),
    "DOUBLE": st.floats(allow_nan=False),
}
NUMBERS |= {"VECTOR3D": NUMBERS["DOUBLE"], "VECTOR6D": NUMBERS["DOUBLE"]}
NUMBERS |= {"VECTOR6INT32": NUMBERS["INT32"], "VECTOR6UINT32": NUMBERS["UINT32"]}


@st.composite
def filled(draw: st.DrawFn) -> tuple[Recipe, dict[str, object]]:
    types = draw(st.lists(st.sampled_from(sorted(FORMATS)), min_size=1, max_size=8))
    values = {}
    for number, kind in enumerate(types):
        width = WIDTHS[kind]
        parts = draw(st.tuples(*[NUMBERS[kind]] * width))
        values[f"v{number}"] = parts[0] if width == 1 else parts
    return Recipe(tuple(values), tuple(types)), values


@given(filled())
def test_what_is_packed_comes_back(both: tuple[Recipe, dict[str, object]]) -> None:
    recipe, values = both
    data = recipe.pack(values)
    assert len(data) == recipe.size
    assert recipe.unpack(data) == values
    assert recipe.unpack(data + b"more") == values
    with pytest.raises(FramingError):
        recipe.unpack(data[:-1])


@given(st.lists(st.tuples(st.integers(0, 255), st.binary(max_size=40)), max_size=8), st.data())
def test_packages_survive_any_cutting(sent: list[tuple[int, bytes]], data: st.DataObject) -> None:
    stream = b"".join(package(command, payload) for command, payload in sent)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=6)))
    framer, found = PackageParser(), []
    for begin, end in zip([0, *cuts], [*cuts, len(stream)], strict=True):
        found += framer.packages(stream[begin:end])
    assert found == sent


@given(st.binary(max_size=200))
def test_no_bytes_do_anything_but_pass_or_be_refused(noise: bytes) -> None:
    try:
        for command, payload in PackageParser().packages(noise):
            assert 0 <= command <= 255
            assert len(payload) <= len(noise)
    except FramingError:
        assert any(size < 3 for size in noise)


def test_a_size_below_the_header_is_refused() -> None:
    with pytest.raises(FramingError, match="2 bytes"):
        list(PackageParser().packages(b"\x00\x02U"))
    with pytest.raises(FramingError, match="65532"):
        package(85, bytes(65533))
    assert math.isclose(len(package(85, bytes(65532))), 65535)
