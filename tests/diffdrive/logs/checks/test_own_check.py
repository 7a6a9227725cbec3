"""A check of one's own, as CONTRIBUTING has it."""

import dataclasses
from functools import partial

import pytest

from diffdrive.errors import ParameterError
from diffdrive.logs import Finding, register_check
from diffdrive.logs.checks import examine as checks
from diffdrive.support.registry import Registry
from tests.support.sound_log import DRIVE, SOUND

HOT = dataclasses.replace(SOUND, temperature=70.0 + 0.0 * SOUND.position)


@pytest.fixture(autouse=True)
def _no_others(monkeypatch):
    monkeypatch.setattr(checks, "_REGISTERED", Registry("check of logs"))


def register_warm(severity):
    @register_check
    def warm(log, axis):
        if axis is not None and log.temperature is not None and log.temperature.max() > 60.0:
            yield Finding(severity, "temperature", "the motor is hotter than 60 degrees", "let it cool", "range")


def test_a_check_of_ones_own_is_asked_of_every_readable_log():
    register_warm("warning")
    assert [one for one in checks.examine(SOUND, DRIVE) if one.channel == "temperature"] == []
    assert [one.severity for one in checks.examine(HOT, DRIVE) if one.channel == "temperature"] == ["warning"]
    assert [one for one in checks.examine(HOT) if "hotter" in one.message] == []


def test_a_check_that_is_defined_again_is_asked_once():
    register_warm("warning")
    register_warm("note")
    assert [one.severity for one in checks.examine(HOT, DRIVE) if one.channel == "temperature"] == ["note"]


@pytest.mark.parametrize("check", [lambda log, axis: (), partial(max, 1)])
def test_a_check_without_a_name_is_refused(check):
    with pytest.raises(ParameterError, match="must be a function with a name"):
        register_check(check)
