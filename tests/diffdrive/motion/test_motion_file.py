"""A motion from a file means what its header says."""

import numpy as np
import pytest

from diffdrive.errors import MotionError
from diffdrive.motion.file import parse_motion_table, read_motion

TIME = np.arange(201) / 1e4
PLACE = 1e-3 * np.sin(2 * np.pi * 5.0 * TIME)
SEEN = PLACE + 1e-6


def text(header, *columns):
    rows = np.array(columns).T.tolist()
    return "\n".join([header, *(",".join(map(repr, row)) for row in rows)])


@pytest.mark.parametrize(
    ("header", "time", "place"),
    [
        ("time,position", 1.0, 1.0),
        ("Time [s], Position [m]", 1.0, 1.0),
        ("time [ms],position [mm]", 1e3, 1e3),
        ("time (s),position (um)", 1.0, 1e6),
        ('"time_ms","position_mm"', 1e3, 1e3),
        ("time,position [50 nm]", 1.0, 1 / 50e-9),
        ("time,reference [mm]", 1.0, 1e3),
    ],
)
def test_the_units_of_the_header_count(header, time, place):
    motion = parse_motion_table(text(header, time * TIME, place * PLACE), "own.csv")
    np.testing.assert_allclose(motion.time, TIME, rtol=0, atol=1e-12)
    np.testing.assert_allclose(motion.position, PLACE, rtol=1e-12, atol=1e-18)
    assert motion.name == "own.csv"


def test_the_reference_goes_before_what_was_measured_and_is_named():
    motion = parse_motion_table(text("time,position [mm],reference", TIME, 1e3 * SEEN, PLACE), "run.csv")
    np.testing.assert_array_equal(motion.position, PLACE)
    assert motion.name == "run.csv (column reference)"


@pytest.mark.parametrize(
    ("header", "says"),
    [
        ("time [s],position [kg]", "own.csv: column 'position \\[kg\\]': 'kg' is no unit of the position"),
        ("time [mm],position", "column 'time \\[mm\\]': 'mm' is no unit of the time"),
        ("time,position [counts]", "'counts' is no unit of the position"),
        ("time,place", "needs a header line with the columns time and position .*has 'time', 'place'"),
        ("time,position,position [mm]", "has 2 columns called position: leave one"),
        ("0.0,0.0", "needs a header line"),
    ],
)
def test_a_header_that_says_something_else_is_refused(header, says):
    columns = [TIME, *([PLACE] * header.count(","))]
    with pytest.raises(MotionError, match=says):
        parse_motion_table(text(header, *columns), "own.csv")


def test_a_file_that_is_no_text_is_named(tmp_path):
    path = tmp_path / "own.csv"
    for raw in (b"\xff\xfe\x00", b"\x00\xff" * 100, b"", b"time,position\n\n"):
        path.write_bytes(raw)
        with pytest.raises(MotionError, match=r"own\.csv: not a comma-separated table of numbers"):
            parse_motion_table(read_motion(path), str(path))
    with pytest.raises(MotionError, match=r"absent\.csv: cannot be read"):
        read_motion(tmp_path / "absent.csv")


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "latin-1"])
def test_a_motion_is_read_in_the_encodings_of_a_log(encoding, tmp_path):
    path = tmp_path / "own.csv"
    path.write_bytes(text("time [s],position [µm]", TIME, 1e6 * PLACE).encode(encoding))
    np.testing.assert_allclose(parse_motion_table(read_motion(path), str(path)).position, PLACE, rtol=1e-12, atol=1e-18)


def test_a_header_of_very_many_names_is_counted_and_not_printed():
    header = ",".join(f"signal {k}" for k in range(20_000))
    with pytest.raises(MotionError, match=r"has 20000 columns, 'signal 0', .* and 19990 more$") as error:
        parse_motion_table(f"{header}\n{','.join('0' * 20_000)}\n", "own.csv")
    assert len(str(error.value)) < 600
