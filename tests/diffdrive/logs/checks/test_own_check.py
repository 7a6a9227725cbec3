"""A check of one's own, as CONTRIBUTING has it."""

import dataclasses

from diffdrive.logs.checks import examine as checks
from diffdrive.logs.checks.finding import Finding
from tests.support.sound_log import DRIVE, SOUND


def test_a_check_of_ones_own_is_asked_of_every_readable_log(monkeypatch):
    monkeypatch.setattr(checks, "_REGISTERED", [])

    @checks.register
    def warm(log, axis):
        if axis is not None and log.temperature is not None and log.temperature.max() > 60.0:
            yield Finding("warning", "temperature", "the motor is hotter than 60 degrees", "let it cool", "range")

    hot = dataclasses.replace(SOUND, temperature=70.0 + 0.0 * SOUND.position)
    assert [one for one in checks.examine(SOUND, DRIVE) if one.channel == "temperature"] == []
    assert [one.severity for one in checks.examine(hot, DRIVE) if one.channel == "temperature"] == ["warning"]
    assert [one for one in checks.examine(hot) if "hotter" in one.message] == []
