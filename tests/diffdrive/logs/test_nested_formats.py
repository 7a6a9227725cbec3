"""Files that nest what they hold, HDF5 groups and MCAP messages: columns by their paths."""

import h5py
import numpy as np
import pytest

from diffdrive.errors import LogError
from diffdrive.logs import ColumnMapping, read_log
from diffdrive.logs.read import read_table
from tests.support.recorder_files import LISTS, STAMPS, write_hdf5, write_mcap, write_plain
from tests.support.written_log import COLUMNS, COMMAND, POSITION, REFERENCE, TIME, N, assert_is_the_log

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
