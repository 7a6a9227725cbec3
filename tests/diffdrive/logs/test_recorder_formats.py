"""Files of recorders, MDF, TDMS, HDF5 and MCAP, written with their libraries and read back to the last bit."""

import json
import sys

import h5py
import numpy as np
import pytest

from diffdrive.errors import LogError
from diffdrive.logs import ColumnMapping, read_log
from diffdrive.logs.read import read_table
from tests.support.written_log import COLUMNS, COMMAND, POSITION, REFERENCE, TIME, N, assert_is_the_log

SIGNALS = {name: values for name, values in COLUMNS.items() if name != "time"}
SLOW = {"time": TIME[::10], "temperature": 20.0 + TIME[::10]}


def write_mdf(path, groups, **options):
    """Groups of (stamps, {name: values or keywords of a Signal})."""
    library = pytest.importorskip("asammdf", reason="asammdf is an extra")
    with library.MDF(version="3.30" if path.suffix == ".mdf" else "4.10") as file:
        for name, (stamps, channels) in groups.items():
            signals = [
                library.Signal(**(one if isinstance(one, dict) else {"samples": one}), timestamps=stamps, name=key)
                for key, one in channels.items()
            ]
            file.append(signals, acq_source=None, comment=name, **options)
            if path.suffix == ".mf4":
                file.groups[-1].channel_group.acq_name = name
        file.save(path, overwrite=True)


def write_tdms(path, channels):
    """Channels of (group, name, values, properties)."""
    library = pytest.importorskip("nptdms", reason="npTDMS is an extra")
    with library.TdmsWriter(str(path)) as file:
        file.write_segment([library.ChannelObject(*channel) for channel in channels])


def write_hdf5(path, arrays, units=None):
    with h5py.File(path, "w") as file:
        for name, values in arrays.items():
            file[name] = values
            if units and name in units:
                file[name].attrs["units"] = units[name]


def write_mcap(path, topics, *, encoding="json", **options):
    """Topics of (stamps in ns, fields by name)."""
    library = pytest.importorskip("mcap.writer", reason="mcap is an extra")
    with path.open("wb") as stream:
        file = library.Writer(stream, **options)
        file.start()
        schema = file.register_schema("signals", "jsonschema", b"{}")
        for topic, (stamps, fields) in topics.items():
            channel = file.register_channel(topic, encoding, schema)
            for k, stamp in enumerate(stamps):
                data = {name: values[k] for name, values in fields.items()}
                file.add_message(channel, int(stamp), json.dumps(data).encode(), int(stamp))
        file.finish()


STAMPS = 1_700_000_000_000_000_000 + np.rint(1e9 * TIME).astype(np.int64)
LISTS = {name: values.tolist() for name, values in SIGNALS.items()}
WAVEFORM = {"wf_start_offset": 0.0, "wf_increment": 1e-3, "wf_samples": N}


def write_plain(path):
    """The log as each format holds it plainly."""
    if path.suffix in (".mf4", ".mdf"):
        write_mdf(path, {"axis": (TIME, SIGNALS)})
    elif path.suffix == ".tdms":
        write_tdms(path, [("axis", name, values, WAVEFORM) for name, values in SIGNALS.items()])
    elif path.suffix == ".mcap":
        write_mcap(path, {"/axis": (np.rint(1e9 * TIME), LISTS)})
    else:
        write_hdf5(path, COLUMNS)


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


# --- HDF5 -------------------------------------------------------------------------------------------------------------


def test_hdf5_groups_and_units(tmp_path):
    path = tmp_path / "log.h5"
    arrays = {"rig/t": 1e3 * TIME, "rig/x/ref": 1e3 * REFERENCE, "rig/x/act": 1e6 * POSITION, "u": 1e-3 * COMMAND}
    units = {"rig/t": "ms", "rig/x/ref": np.bytes_("mm"), "rig/x/act": np.array(["um"], dtype=object), "u": "kN"}
    write_hdf5(path, arrays, units)
    mapping = ColumnMapping({"time": "rig/t", "reference": "ref", "position": "x/act", "command": "u"})
    assert_is_the_log(read_log(path, mapping=mapping))


def test_hdf5_tables_of_fields_and_matrices(tmp_path):
    path = tmp_path / "log.h5"
    kinds = [("time", "f8"), ("axis", "f8", (2,)), ("command", "f8"), ("state", "S3")]
    rows = np.zeros(N, dtype=kinds)
    rows["time"], rows["axis"], rows["command"] = TIME, np.column_stack([REFERENCE, POSITION]), COMMAND
    write_hdf5(path, {"log/rows": rows})
    mapping = ColumnMapping({"reference": "axis(1)", "position": "axis(2)"})
    assert_is_the_log(read_log(path, mapping=mapping), exact=True)
    write_hdf5(path, {"time": TIME, "y": np.column_stack([REFERENCE, POSITION, COMMAND])})
    mapping = ColumnMapping({"reference": "y(1)", "position": "y(2)", "command": "y(3)"})
    assert_is_the_log(read_log(path, mapping=mapping), exact=True)


def test_hdf5_what_is_no_signal_is_named(tmp_path):
    path = tmp_path / "log.h5"
    write_hdf5(path, COLUMNS | {"title": "lap", "kp": 3.0, "z": 1j * TIME, "nothing": h5py.Empty("f8")})
    with h5py.File(path, "a") as file:
        file["soft"] = h5py.SoftLink("/position")
        file["other"] = h5py.ExternalLink("/etc/passwd", "x")
        file["circle/group"] = file["/"]
    log = read_log(path)
    assert_is_the_log(log, exact=True)
    assert log.notes == (
        "left out, since a signal is one number in each row: 'other' is a link into another file, 'soft' is a link to "
        "'/position', 'nothing' is empty, 'z' holds complex numbers",
    )
    write_hdf5(path, {"title": "lap", "kp": 3.0})
    with pytest.raises(LogError, match=r"holds no arrays of numbers \('kp' holds a single value, 'title' holds text\)"):
        read_log(path)


def test_hdf5_declared_sizes_are_checked_before_memory_is_taken(tmp_path):
    path = tmp_path / "log.h5"
    with h5py.File(path, "w") as file:  # a file of a few kB
        file.create_dataset("position", shape=(10**15,), dtype="f8", chunks=(1000,))
    with pytest.raises(LogError, match=r"reading 1e\+15 numbers would take about 24 PB"):
        read_log(path)


def test_hdf5_data_sets_of_other_lengths_are_refused_only_where_they_are_meant(tmp_path):
    path = tmp_path / "log.h5"
    write_hdf5(path, COLUMNS | {"spare": np.arange(7.0)})
    assert_is_the_log(read_log(path), exact=True)
    with pytest.raises(LogError, match="'spare' has 7 values, 'time' has 400"):
        read_log(path, columns={"load": "spare"})


# --- MCAP -------------------------------------------------------------------------------------------------------------


def test_mcap_topics_are_flattened_and_their_times_counted_exactly(tmp_path):
    path = tmp_path / "log.mcap"
    nested = {"axis": [{"ref": r, "act": p, "tags": [1, 2]} for r, p in zip(REFERENCE, POSITION, strict=True)]}
    fields = nested | {"force": COMMAND.tolist(), "state": ["RUN"] * N}
    write_mcap(path, {"/rig/x": (STAMPS, fields), "/video": (STAMPS[:3], {"k": [0, 1, 2]})})
    log = read_log(path, columns={"reference": "axis/ref", "position": "axis/act", "command": "force"})
    np.testing.assert_allclose(log.time, TIME, atol=1e-12)
    np.testing.assert_array_equal(log.position, POSITION)
    np.testing.assert_array_equal(log.command, COMMAND)
    assert "'rig/x/axis/tags' holds a list in each message" in "".join(log.notes)


def test_mcap_topics_of_two_clocks_are_compared(tmp_path):
    path = tmp_path / "log.mcap"
    axis = {name: LISTS[name] for name in ("reference", "position")}
    drive = {"command": LISTS["command"]}
    write_mcap(path, {"axis": (STAMPS, axis), "drive": (STAMPS, drive)})
    np.testing.assert_array_equal(read_log(path).command, COMMAND)
    write_mcap(path, {"axis": (STAMPS, axis), "drive": (STAMPS + 300_000, drive)})
    with pytest.raises(LogError, match=r"the command's own clock, 'drive.clock', is 0\.3 ms ahead of 'time'"):
        read_log(path)


def test_mcap_fields_that_some_messages_lack_are_missing_there(tmp_path):
    path = tmp_path / "log.mcap"
    write_mcap(path, {"axis": (STAMPS, LISTS | {"spare": [None] * 3 + [1.0] * (N - 3)})})
    values = read_table(path).columns["axis/spare"]
    assert np.isnan(values[:3]).all()
    assert set(values[3:]) == {1.0}


@pytest.mark.parametrize("encoding", ["protobuf", "cdr", "ros1"])
def test_mcap_messages_of_another_encoding_are_named(encoding, tmp_path):
    path = tmp_path / "log.mcap"
    write_mcap(path, {"/axis": (STAMPS, LISTS)}, encoding=encoding)
    with pytest.raises(LogError, match=rf"holds no JSON messages .*'axis' is encoded as '{encoding}', not as JSON"):
        read_log(path)


def test_mcap_messages_that_are_no_json_are_refused(tmp_path):
    path = tmp_path / "log.mcap"
    write_plain(path)
    data = path.read_bytes()
    write_mcap(path, {"/axis": (STAMPS, LISTS)}, compression=pytest.importorskip("mcap.writer").CompressionType.NONE,
               enable_crcs=False)  # fmt: skip
    data = path.read_bytes().replace(b'{"reference"', b'["reference"')
    path.write_bytes(data)
    with pytest.raises(LogError, match="cannot be read as MCAP"):
        read_log(path)
