"""A channel that was recorded early or late is brought into time."""

import dataclasses
import re

import numpy as np
import pytest

from diffdrive.axis_file.drive_file import parse_axis, read_axis, write_axis
from diffdrive.errors import LogError
from diffdrive.logs import read_log, read_logs, write_log
from diffdrive.logs.checks.examine import examine
from diffdrive.logs.clocks.shifts import shift_channels
from diffdrive.logs.mapping import ColumnMapping, parse_mapping
from diffdrive.model.data_sheet import DataSheet
from experiments.reports.checked_logs import mapping_with_options
from tests.support.sound_log import DRIVE, RATE, SOUND, delayed, replaced
from tests.support.written_log import COLUMNS, COMMAND, NAMES, POSITION, REFERENCE, TIME, N, rows


@pytest.fixture
def written(tmp_path):
    path = tmp_path / "late.csv"
    path.write_text(f"{NAMES}\n{rows()}")
    return path


@pytest.mark.parametrize("shifts", [{"command": -1}, {"command": 3}, {"position": 2, "command": -2}])
def test_each_channel_has_its_value_of_so_many_samples_sooner_and_the_others_theirs(written, shifts):
    log = read_log(written, mapping=ColumnMapping(shifts=shifts))
    first = round(log.time[0] * 1e3)
    for channel, values in COLUMNS.items():
        begin = first - shifts.get(channel, 0)
        np.testing.assert_allclose(log.channels[channel], values[begin : begin + len(log.time)], rtol=1e-12)
    spread = max(0, *shifts.values()) - min(0, *shifts.values())
    assert len(log.time) == N - spread
    for channel, by in shifts.items():
        assert f"the {channel} was shifted by {by:+d} samples" in log.notes


@pytest.mark.parametrize("key", ["late:command", "late.csv:command", "monday/late:command", " late : command"])
def test_a_shift_of_one_log_goes_before_that_of_all(tmp_path, key):
    """The log may be named with its extension and its folder, whatever else is called nearly alike."""
    logs = ["monday/late.csv", "monday/later.csv", "monday/late.1.csv", "monday/late.csv.csv"]
    (tmp_path / "monday").mkdir()
    mapping = ColumnMapping(shifts={key: -1, "command": 1})
    for name in logs:
        moved_by = -1 if name == logs[0] or (name == logs[3] and ".csv" in key) else 1
        path = tmp_path / name
        path.write_text(f"{NAMES}\n{rows()}")
        log = read_log(path, mapping=mapping)
        assert f"the command was shifted by {moved_by:+d} samples" in log.notes
        assert log.shifts == {"command": moved_by}


def test_of_two_logs_of_one_name_the_folder_tells_which_and_goes_before_the_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    mapping = ColumnMapping(shifts={"monday/late:command": -2, "late:command": 1, "late:position": 3})
    (tmp_path / "monday").mkdir()
    for folder in (".", "monday"):
        (tmp_path / folder / "late.csv").write_text(f"{NAMES}\n{rows()}")
    here, there = read_logs(["late.csv", "monday/late.csv"], mapping=mapping)
    assert (here.shifts, there.shifts) == ({"command": 1, "position": 3}, {"command": -2, "position": 3})
    assert (here.name, there.name) == (f"{tmp_path.name}/late", "monday/late")


def test_what_is_stated_for_all_logs_goes_before_what_the_file_says_of_one(written):
    file = ColumnMapping(shifts={"lap=5:command": 1, "lap2:position": 2})
    assert file.overridden({}, {}, {"command": 0}).shifts == {"lap2:position": 2, "command": 0}
    assert file.overridden({}, {}, {"lap=5:command": -3}).shifts == {"lap=5:command": -3, "lap2:position": 2}
    of_one = ColumnMapping(shifts={"late:command": 2})
    assert read_log(written, mapping=of_one, shifts={"command": -1}).shifts == {"command": -1}


def test_what_is_not_moved_is_as_it_was(written):
    plain, none = read_log(written), read_log(written, mapping=ColumnMapping(shifts={"command": 0}))
    assert plain.notes == none.notes
    for channel, values in plain.channels.items():
        np.testing.assert_array_equal(none.channels[channel], values)


def test_no_value_crosses_a_gap():
    """Stretches of 6, 2 and 5 samples, moved by two: each loses two, the second is gone."""
    place = np.arange(13.0)
    signals, gaps, _ = shift_channels("log", {"position": place, "command": place}, (6, 8), {"command": 2})
    np.testing.assert_array_equal(signals["position"], [2, 3, 4, 5, 10, 11, 12])
    np.testing.assert_array_equal(signals["command"], [0, 1, 2, 3, 8, 9, 10])
    assert gaps == (4,)


@pytest.mark.long
@pytest.mark.parametrize(
    ("channel", "late", "already", "key"),
    [  # every channel, every move before and every key come together in pairs
        ("command", -2, 0, "{}"),
        ("command", 1, 1, "late:{}"),
        ("command", 1, -2, "a folder/late:{}"),
        ("position", 1, 0, "late:{}"),
        ("position", -1, 1, "a folder/late:{}"),
        ("position", -1, -2, "{}"),
        ("reference", 2, 0, "a folder/late:{}"),
        ("reference", -1, 1, "{}"),
        ("reference", 2, -2, "late:{}"),
    ],
)
def test_the_options_that_a_finding_names_mend_it(channel, late, already, key, tmp_path):
    """Whatever [shifts] moved before, of all logs or of this one, that it is out of time by so much more."""
    drive = dataclasses.replace(DRIVE, mapping=ColumnMapping(shifts={key.format(channel): already}))
    path = tmp_path / "a folder" / "late.csv"
    path.parent.mkdir()
    write_log(path, replaced(**{channel: delayed(SOUND.channels[channel], late - already)}))

    def shifts_of(description):
        found = examine(read_log(path, mapping=description.mapping, rate=RATE), description)
        return [one for one in found if one.severity != "note" and "shift" in one.message]

    (finding,) = shifts_of(drive)
    options = re.findall(r"--shift (\S+?)[,)]", finding.remedy)
    assert len(options) == 1
    plain = {name: by for name, by in drive.mapping.shifts.items() if "/" not in name}  # which would go before it
    mended = mapping_with_options(ColumnMapping(shifts=plain), shifts=options)
    assert not shifts_of(dataclasses.replace(drive, mapping=mended))
    ((named, by),) = re.findall(r'"(\S+)" = (\S+) in \[shifts\]', finding.remedy)
    assert f"{named}={int(by):+d}" == options[0]


def test_what_was_injected_moves_with_the_command_that_holds_it(tmp_path):
    """A pulse of 8 N, recorded by the same late interrupt as the command that holds it."""
    pulse = np.where((TIME > 0.1) & (TIME < 0.2), 8.0, 0.0)
    path = tmp_path / "late.csv"
    columns = (TIME, REFERENCE, POSITION, delayed(COMMAND + pulse, 1), delayed(pulse, 1))
    path.write_text(f"{NAMES},injected\n{rows(columns=columns)}")
    log = read_log(path, mapping=ColumnMapping(shifts={"command": -1}))
    np.testing.assert_allclose(log.command[1:], COMMAND[1:-1], rtol=0, atol=1e-12)
    np.testing.assert_array_equal(log.disturbance[1:], pulse[1:-1])
    apart = read_log(path, mapping=ColumnMapping(shifts={"command": -1, "injected": 0}))
    assert np.abs(apart.command[1:] - COMMAND[1:-1]).max() == pytest.approx(8.0)


@pytest.mark.parametrize(
    ("build", "says"),
    [
        (lambda: ColumnMapping(shifts={"comand": -1}), r"\[shifts\] comand: .*did you mean 'command'"),
        (lambda: ColumnMapping(shifts={":command": -1}), r"\[shifts\] :command: names no log"),
        (lambda: ColumnMapping(shifts={"lap2:comand": -1}), r"\[shifts\] lap2:comand: .*did you mean 'command'"),
        (
            lambda: ColumnMapping(shifts={"lap2:command": 0.5}),
            r"\[shifts\] lap2:command: must be a whole number of samples",
        ),
        (lambda: ColumnMapping(shifts={"time": -1}), r"\[shifts\] time: no channel that can be shifted"),
        (lambda: ColumnMapping(shifts={"command": 0.5}), r"\[shifts\] command: must be a whole number of samples"),
        (
            lambda: parse_mapping(DataSheet(), {}, {}, {"command": "late"}),
            r"\[shifts\] command: must be a whole number",
        ),
        (lambda: parse_mapping(DataSheet(), {}, {}, 3), r"\[shifts\] must be a table"),
    ],
)
def test_what_is_no_shift_is_refused(build, says):
    with pytest.raises(LogError, match=says):
        build()


def test_a_shift_of_what_is_not_there_or_of_the_whole_log_is_refused(written):
    with pytest.raises(LogError, match=r"late.csv: load is to be shifted: the log has no such channel"):
        read_log(written, mapping=ColumnMapping(shifts={"load": 1}))
    with pytest.raises(LogError, match=r"late.csv: shifts by 1000+ samples leave nothing"):
        read_log(written, mapping=ColumnMapping(shifts={"command": 10**20}))
    with pytest.raises(LogError, match=r"late.csv: shifts by 400 samples leave nothing"):
        read_log(written, mapping=ColumnMapping(shifts={"command": 200, "position": -200}))


def test_a_drive_file_carries_it_and_the_command_line_overrides_it(tmp_path):
    written = {"shifts": {"command": -1, "position": 2}} | {
        "plant": {"mass": 140.0, "damping": 420.0},
        "friction": {"coulomb_screw": 95.0, "load_coefficient": 0.0, "initial_load": 0.0, "breakaway_gap": 32.0,
                     "stribeck_velocity": 1.2e-3, "viscous": 1900.0, "bristle_stiffness": 4e7, "bristle_damping": 5e3},
        "controller": {"kind": "pd", "kp": 1.6e6, "kd": 9e3},
        "sampling": {"rate": 2000.0},
    }  # fmt: skip
    described = parse_axis(written)
    assert described.mapping.shifts == {"command": -1, "position": 2}
    write_axis(tmp_path / "drive.toml", described)
    assert read_axis(tmp_path / "drive.toml").mapping == described.mapping
    assert described.mapping.overridden({}, {}, {"command": 3}).shifts == {"command": 3, "position": 2}
