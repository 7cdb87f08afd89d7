"""Devices from Python: the examples of the functions that connect to them, and what the host refuses."""

from __future__ import annotations

import doctest
import inspect

import pytest

import labhil as lh
from labhil.errors import CommandRefusedError, LimitTrippedError, UnknownNameError, UsageError
from labhil.public import public


@pytest.mark.extended
@pytest.mark.parametrize("name", ["Bench", "Experiment", "connect", "run"])
def test_the_example_is_true(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    found = doctest.DocTestParser().get_doctest(inspect.getdoc(public(name)) or "", {}, name, None, 0)
    told: list[str] = []
    doctest.DocTestRunner().run(found, out=told.append)
    assert "".join(told) == ""


@pytest.fixture
def limited(tmp_path):
    rig = tmp_path / "motor.toml"
    rig.write_text(
        '[rig]\nkind = "dc_motor"\n[limits]\nvoltage = { min = -2, max = 2 }\nspeed = { max = 60 }\n'
    )
    return rig


@pytest.mark.extended
def test_commands_beyond_the_limits_are_refused_and_misspelt_ones_are_named(limited):
    with lh.connect("dc_motor", "twin", rig=limited) as bench:
        assert bench.command(voltage=1.0) == {"voltage": 1.0}
        with pytest.raises(CommandRefusedError, match="voltage"):
            bench.command(voltage=5.0)
        with pytest.raises(UnknownNameError, match="did you mean 'voltage'"):
            bench.command(voltge=1.0)
        with pytest.raises(UsageError, match="expected a number"):
            bench.command(voltage="1")


@pytest.mark.extended
def test_a_device_that_left_its_limits_is_not_commanded_before_it_is_rearmed(tmp_path):
    rig = tmp_path / "motor.toml"
    rig.write_text('[rig]\nkind = "dc_motor"\n[limits]\nspeed = { max = 5 }\n')
    with lh.connect("dc_motor", "twin", rig=rig) as bench:
        with pytest.raises(LimitTrippedError, match="rearm"):
            bench.command(voltage=12.0, hold=3.0)
        bench.collect(1.0)
        bench.rearm()
        assert bench.command(voltage=0.1) == {"voltage": 0.1}


def test_what_cannot_be_connected_is_refused_at_once():
    with pytest.raises(UsageError, match="did you mean 'dc_motor'"):
        lh.connect("dc_moter", "twin")
    with pytest.raises(UsageError, match="sped"):
        lh.connect("dc_motor", "twin", twin={"sped": 2.0})
    with pytest.raises(UsageError, match="expected one of kind 'dc_motor'"):
        lh.connect("dc_motor", "twin", rig="ball_beam")
    with pytest.raises(UsageError, match="not connected"):
        lh.connect("dc_motor", "twin").read()
