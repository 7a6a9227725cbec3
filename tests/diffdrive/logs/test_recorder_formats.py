"""Files of recorders, MDF, TDMS, HDF5 and MCAP, written with their libraries and read back to the last bit."""

import sys

import numpy as np
import pytest

from diffdrive.errors import LogError
from diffdrive.logs import read_log
from diffdrive.logs.read import read_table
from tests.support.recorder_files import SIGNALS, STAMPS, WAVEFORM, write_mdf, write_plain, write_tdms
from tests.support.written_log import COLUMNS, COMMAND, POSITION, REFERENCE, TIME, N, assert_is_the_log

SLOW = {"time": TIME[::10], "temperature": 20.0 + TIME[::10]}
EXTENSIONS = (".mf4", ".mdf", ".tdms", ".h5", ".hdf5", ".mcap")


@pytest.mark.parametrize("extension", EXTENSIONS)
def test_a_log_is_read_to_the_last_bit(extension, tmp_path):
    path = tmp_path / f"log{extension}"
    write_plain(path)
    log = read_log(path)
    assert_is_the_log(log, exact=extension != ".mcap")  # whose ns are counted
    assert log.notes == ()


@pytest.mark.parametrize("extension", EXTENSIONS)
@pytest.mark.parametrize("kept", [0.0, 0.02, 0.5, 0.97])
def test_a_truncated_file_is_refused_or_noted(extension, kept, tmp_path):
    path = tmp_path / f"log{extension}"
    write_plain(path)
    data = path.read_bytes()
    path.write_bytes(data[: int(kept * len(data))])
    if extension == ".tdms" and kept > 0.4:  # its values stand one behind the other, as they came
        assert any("may have been longer" in note for note in read_table(path).notes)
        return
    with pytest.raises(LogError, match=r"cut off|is empty") as error:
        read_log(path)
    assert str(error.value).startswith(str(path))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("extension", EXTENSIONS)
@pytest.mark.parametrize("content", [np.random.default_rng(0).bytes(5000), b"time,position,command\n0,1,2\n"])
def test_another_content_under_the_extension_is_refused(extension, content, tmp_path, capfd):
    write_plain(tmp_path / f"whole{extension}")  # skips where the library is missing
    path = tmp_path / f"log{extension}"
    path.write_bytes(content)
    with pytest.raises(LogError, match="it is another format or cut off") as error:
        read_log(path)
    assert "\n" not in str(error.value)
    assert capfd.readouterr() == ("", "")  # libraries that log to the terminal are silent


@pytest.mark.parametrize("extension", EXTENSIONS)
def test_a_log_that_does_not_fit_is_refused_before_it_is_read(extension, tmp_path, monkeypatch):
    path = tmp_path / f"log{extension}"
    write_plain(path)
    monkeypatch.setattr("diffdrive.support.resources.memory_available", lambda: 3e4)
    with pytest.raises(LogError, match=r"reading .* would take about .* of memory, and 30 kB are free: cut it"):
        read_log(path)


@pytest.mark.parametrize(("extension", "module"), [(".mf4", "asammdf"), (".tdms", "nptdms"), (".mcap", "mcap.reader")])
def test_a_missing_library_is_named_with_its_remedy(extension, module, tmp_path, monkeypatch):
    path = tmp_path / f"log{extension}"
    path.write_bytes(b"x")
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(LogError, match=r"a package that is not installed .*: pip install 'diffdrive\[formats\]'$"):
        read_log(path)


@pytest.mark.parametrize("extension", EXTENSIONS)
def test_a_damaged_file_is_read_or_refused_in_one_line(extension, tmp_path):
    path = tmp_path / f"log{extension}"
    write_plain(path)
    whole, rng = path.read_bytes(), np.random.default_rng(0)
    for _ in range(20):
        data = bytearray(whole)
        for begin in rng.integers(len(data), size=3):
            data[begin : begin + 4] = rng.bytes(4) if rng.random() < 0.5 else b"\xff" * 4
        path.write_bytes(data[: len(whole)])
        messages = []
        try:
            read_table(path)
        except LogError as error:
            messages = [str(error)]
        assert not any("\n" in message for message in messages)


# --- MDF --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("extension", [".mf4", ".mdf"])
def test_mdf_units_and_conversions_are_applied(extension, tmp_path):
    path = tmp_path / f"log{extension}"
    counts = np.rint(1e9 * POSITION).astype(np.int32)
    channels = {
        "reference": {"samples": 1e3 * REFERENCE, "unit": "mm"},
        "position": {"samples": counts, "unit": "um", "conversion": {"a": 1e-3, "b": 0.0}},
        "command": {"samples": 1e-3 * COMMAND, "unit": "kN"},
        "state": {"samples": (np.arange(N) % 2).astype(np.uint8), "conversion": TEXTS},
    }
    write_mdf(path, {"axis": (TIME, channels)})
    log = read_log(path)
    assert_is_the_log(log)
    assert log.notes == ("left out, since a signal is one number in each row: 'state' is converted to texts",)


TEXTS = {"val_0": 0, "text_0": b"off", "val_1": 1, "text_1": b"on", "default": b""}


def test_mdf_groups_of_several_clocks_are_told_apart(tmp_path):
    path = tmp_path / "log.mf4"
    slow = {"temperature": SLOW["temperature"], "position": POSITION[::10]}
    write_mdf(path, {"plc": (SLOW["time"], slow), "axis": (TIME, SIGNALS)})
    table = read_table(path)
    assert list(table.columns) == [
        "temperature", "plc/position", "reference", "axis/position", "command", "time", "plc.clock",
    ]  # fmt: skip
    with pytest.raises(LogError, match=r"'plc/position', 'axis/position' may each be the position; say which"):
        read_log(path)
    with pytest.raises(LogError, match=r"column 'temperature' has 40 values, 'time' has 400"):
        read_log(path, columns={"position": "axis/position"})
    write_mdf(path, {"plc": (SLOW["time"], {"heat": SLOW["temperature"]}), "axis": (TIME, SIGNALS)})
    log = read_log(path)
    assert_is_the_log(log, exact=True)
    assert log.notes == (
        "channels of 2 clocks: 'time' is that of 'axis', with 3 channels of 400 samples; the others are 'plc.clock'",
    )
    with pytest.raises(LogError, match=r"column 'reference' has 400 values, 'plc.clock' has 40"):
        read_log(path, columns={"time": "plc.clock"})


def test_mdf_groups_that_tick_alike_are_one_and_others_are_compared_row_by_row(tmp_path):
    path = tmp_path / "log.mf4"
    drive = {"command": COMMAND}
    axis = {"reference": REFERENCE, "position": POSITION}
    write_mdf(path, {"axis": (TIME, axis), "drive": (TIME, drive)})
    log = read_log(path)
    assert_is_the_log(log, exact=True)
    assert log.notes == ()
    write_mdf(path, {"axis": (TIME, axis), "drive": (TIME + 2e-3, drive)})
    log = read_log(path)
    np.testing.assert_array_equal(log.command, COMMAND[: N - 2])
    np.testing.assert_array_equal(log.position, POSITION[2:])
    assert any("'drive.clock', is 2 ms ahead of 'time': shifted by 2 samples" in note for note in log.notes)
    write_mdf(path, {"axis": (TIME, axis), "drive": (1.01 * TIME, drive)})
    with pytest.raises(LogError, match=r"the command's own clock, 'drive.clock', is .* export channels of one task"):
        read_log(path)


def test_mdf_values_that_the_file_marks_invalid_are_missing(tmp_path):
    path = tmp_path / "log.mf4"
    invalid = np.zeros(N, bool)
    invalid[100] = True
    channels = SIGNALS | {"position": {"samples": POSITION, "invalidation_bits": invalid}}
    write_mdf(path, {"axis": (TIME, channels)})
    assert np.flatnonzero(np.isnan(read_table(path).columns["position"])).tolist() == [100]
    assert any("interpolated" in note or "without a value" in note for note in read_log(path).notes)


def test_an_mdf_channel_beyond_its_record_is_refused(tmp_path):
    path = tmp_path / "log.mf4"
    write_plain(path)
    library = pytest.importorskip("asammdf")
    with library.MDF(path) as file:
        channel = file.groups[0].channels[3]
        where = channel.address + 24 + 8 * channel.links_nr + 4  # of its byte offset
        assert channel.byte_offset == 24
    data = bytearray(path.read_bytes())
    data[where : where + 4] = (10**6).to_bytes(4, "little")
    path.write_bytes(data)
    with pytest.raises(LogError, match="channel 'command' lies outside of its record"):
        read_log(path)


def test_an_mdf_file_of_texts_alone_is_refused(tmp_path):
    path = tmp_path / "log.mf4"
    write_mdf(path, {"axis": (TIME, {"state": {"samples": np.ones(N, np.uint8), "conversion": TEXTS}})})
    with pytest.raises(LogError, match=r"holds no channel of numbers \('state' is converted to texts\); export"):
        read_log(path)


# --- TDMS -------------------------------------------------------------------------------------------------------------


def test_tdms_units_and_a_time_channel(tmp_path):
    path = tmp_path / "log.tdms"
    units = {"time": ("ms", 1e3), "reference": ("mm", 1e3), "position": ("um", 1e6), "command": ("kN", 1e-3)}
    channels = [("axis", name, scale * COLUMNS[name], {"unit_string": unit}) for name, (unit, scale) in units.items()]
    write_tdms(path, [*channels, ("axis", "state", ["RUN"] * N, {})])
    log = read_log(path)
    assert_is_the_log(log)
    assert log.notes == ("left out, since a signal is one number in each row: 'axis/state' holds text",)


def test_tdms_stamps_are_counted_from_the_first(tmp_path):
    path = tmp_path / "log.tdms"
    stamps = (STAMPS // 1000).astype("datetime64[us]")
    write_tdms(path, [("axis", name, values, {}) for name, values in (SIGNALS | {"time": stamps}).items()])
    np.testing.assert_allclose(read_log(path).time, TIME, atol=1e-12)


def test_tdms_waveforms_that_start_later_are_shifted_to_their_stamps(tmp_path):
    path = tmp_path / "log.tdms"
    start = np.datetime64("2024-05-01T12:00:00.000000")
    late = WAVEFORM | {"wf_start_time": start + np.timedelta64(2000, "us")}
    early = WAVEFORM | {"wf_start_time": start}
    channels = [("axis", name, SIGNALS[name], early) for name in ("reference", "position")]
    write_tdms(path, [*channels, ("drive", "command", COMMAND, late)])
    log = read_log(path)
    np.testing.assert_array_equal(log.command, COMMAND[: N - 2])
    np.testing.assert_array_equal(log.position, POSITION[2:])
    assert any("'drive.clock', is 2 ms ahead of 'time': shifted by 2 samples" in note for note in log.notes)


def test_a_tdms_file_of_texts_alone_is_refused(tmp_path):
    path = tmp_path / "log.tdms"
    write_tdms(path, [("axis", "state", ["RUN"] * N, {})])
    with pytest.raises(LogError, match=r"holds no channel of numbers \('axis/state' holds text\)"):
        read_log(path)
