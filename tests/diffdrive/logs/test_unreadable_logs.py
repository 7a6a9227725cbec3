"""Files that are no log, or a broken one: each is refused in one line that says what to mend."""

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import scipy.io

from diffdrive.errors import LogError
from diffdrive.logs import ColumnMapping, read_log, read_logs
from tests.support.written_log import (
    COLUMNS,
    COMMAND,
    NAMES,
    PLAIN,
    POSITION,
    REFERENCE,
    TIME,
    N,
    assert_is_the_log,
    rows,
    write_v73,
)


def spoilt(line: int, text: str) -> str:
    lines = (NAMES + "\n" + rows()).splitlines()
    lines[line - 1] = text
    return "\n".join(lines)


FIRST, LAST = np.where(TIME < 0.2, 1.0, np.nan), np.where(TIME < 0.2, np.nan, 1.0)
BAD_CSV = {
    "empty": ("", "is empty"),
    "blank": ("\n \n", "is empty"),
    "only a header": (NAMES + "\n", "no rows of numbers, only text such as 'time,reference"),
    "prose": ("Dear customer,\nthe log, as asked,\nis attached\n", "no rows of numbers"),
    "one row": (NAMES + "\n0,0,0,0\n", "1 samples with a time stamp; a log needs at least 3"),
    "two rows": (NAMES + "\n0,0,0,0\n1,1,1,1\n", "2 samples"),
    "a word in a cell": (spoilt(57, "0.055,0.1,oops,3"), "line 57, column 'position': 'oops' is not a number"),
    "a word in the first row": (spoilt(2, "0,0.1,oops,3"), "line 2, column 'position': 'oops'"),
    "thousands": (
        NAMES.replace(",", ";") + "\n" + rows(";", ",").replace("\n", "\n0,0005;1.234,5;0,0;0,0\n", 1),
        "line 3, column 'reference': '1.234,5' is not a number",
    ),
    **{
        f"thousands, {name}": (
            delimiter.join(["time", "position", "command"]) + "\n"
            + rows(delimiter, decimal, columns=(TIME, TIME, COMMAND))
            + last,
            f"line {N + 2}, column 'position': '{cell}' is not a number where the decimal sign is '{decimal}'; "
            "remove the thousands separators",
        )
        for name, delimiter, decimal, cell, last in (
            ("points beside decimal commas", ";", ",", "1.004", "0,4;1.004;7\n"),
            ("points beside decimal commas, tabs", "\t", ",", "-1.004", "0,4\t-1.004\t7\n"),
            ("commas beside decimal points", ";", ".", "1,004", "0.4;1,004;7\n"),
            ("commas in quotes", ",", ".", "12,004", '0.4,"12,004",7\n'),
            ("commas and a decimal point", ";", ".", "1,004.5", "0.4;1,004.5;7\n"),
            ("millions", ";", ",", "1.004.000", "0,4;1.004.000;7\n"),
        )
    },
    "thousands in all rows of one column": (
        "time;position;command\n" + "".join(f"{k}.5;1,{k:03};{k}\n" for k in range(100, 200)),
        "line 2, column 'position': '1,100' is not a number where the decimal sign is '.'; remove the thousands",
    ),
    "thousands in all rows of two columns": (
        "time;position;command\n" + "".join(f"{k},5;1.{k:03};2.{k:03}\n" for k in range(100, 200)),
        "line 2, column 'position': '1.100' is not a number where the decimal sign is ','; remove the thousands",
    ),
    "thousands, all but some with decimals": (
        "time;position;command\n" + "".join(f"{k};1.{k},5;1.{k}\n" for k in range(100, 200)),
        "line 2, column 'position': '1.100,5' is not a number where the decimal sign is ','; remove the thousands",
    ),
    "two decimal signs": (
        "time;position;command\n" + rows(";", columns=(TIME, POSITION, COMMAND)) + "0.4;0,5;7\n",
        f"line {N + 2}, column 'position': '0,5' is not .* write decimals with one sign",
    ),
    "decimal comma without quotes": (NAMES + "\n" + rows(",", ","), "decimal comma without quotes; export with semico"),
    "decimal comma without quotes, whole times": (
        "time,position,command\n" + rows(columns=(TIME, POSITION, COMMAND)).replace("0.0,", "0,").replace(".", ","),
        "cells below the 3 names in line 1: decimal comma without quotes",
    ),
    "decimal comma without quotes, one column": (
        "time,position,command\n" + "".join(f"{k},{k % 7},0,{k:03}\n" for k in range(50)),
        "line 2 has 4 cells below the 3 names in line 1: decimal comma without quotes; export with semicolons or",
    ),
    "a header that is too short": ("time,position,command\n" + rows(), "no column is called"),
    "a unit of no channel": (
        NAMES + "\ns,mm,um,%\n" + rows(),
        r"column 'command': '%' is no unit of the .* = \"0\.05 N\" \(a torque of 1 N m makes 2 pi / lead newtons",
    ),
    "a label for a unit": (NAMES + "\nunit,mm,um,N\n" + rows(), r"column 'time': 'unit' is no .* time = \"ms\""),
    "stamps of another form": (
        NAMES + "\n" + "".join(f"3/26/24 9:00:00.{k:03},0.1,0.2,{k}\n" for k in range(100)),
        r"line 2, column 'time': '3/26/24 9:00:00\.000' is no time that can be read; export it as .* 26\.03\.2024",
    ),
    "minutes and seconds": (
        NAMES + "\n" + "".join(f"00:00.{k:03},0.1,0.2,{k}\n" for k in range(100)),
        r"'00:00\.000' is no time that can be read; export it as seconds or counts, 9:00:00\.000, ",
    ),
    "a stamp that is none": (
        NAMES + "\n9:00:00.000,0,0,0\n9:00:00.001,0,0,0\n9:00:0o.002,0,0,0\n9:00:00.003,0,0,0\n",
        r"line 4, column 'time': '9:00:0o\.002' is no time like '9:00:00\.000'; correct or empty this cell",
    ),
    "a day that is none": (
        NAMES + "\n28.02.2023 9:00:00,0,0,0\n29.02.2023 9:00:00,0,0,0\n1.3.2023 9:00:00,0,0,0\n",
        r"line 3, column 'time': '29\.02\.2023 9:00:00' is no time like '28\.02\.2023",
    ),
    "short row": (spoilt(57, "0.055,0.1"), "line 57 has 2 columns, the other rows have 4"),
    "long row": (spoilt(57, "0.055,0.1,0,0,0"), "line 57 has 5 columns, the other rows have 4"),
    "no position": (NAMES.replace("position", "positoin") + "\n" + rows(), r"\[columns\] position = \"positoin\""),
    "no command": (NAMES.replace("command", "x") + "\n" + rows(), "no column is called \"command\".*'x'"),
    "no time": (NAMES.replace("time", "x") + "\n" + rows(), 'no column is called "time"'),
    "two positions": (
        NAMES + ",Position [mm]\n" + rows(columns=(*COLUMNS.values(), POSITION)),
        r"'position', 'Position \[mm\]' may each be the position.*--column position=",
    ),
    "a header to be pasted": (
        NAMES.replace("position", "positio [mm]") + "\n" + rows(), r'or --column "position=positio \[mm\]"',
    ),
    "the same name twice": (NAMES.replace("reference", "position") + "\n" + rows(), "'position#1', 'position#2'"),
    "a unit that is none": (NAMES.replace("position", "position [foo]") + "\n" + rows(), r"'position \[foo\]': 'foo'"),
    "the wrong unit": (NAMES.replace("position", "position [V]") + "\n" + rows(), "'V' is no unit of the position"),
    "volts": (NAMES.replace("command", "command [V]") + "\n" + rows(), r"needs force_per_volt in \[units\]"),
    "no value": (NAMES + "\n" + rows(columns=(TIME, REFERENCE, POSITION * np.nan, COMMAND)), "position has no value"),
    "never complete": (
        NAMES + "\n" + rows(columns=(TIME, REFERENCE, FIRST * POSITION, LAST * COMMAND)),
        "no sample has a value in all of",
    ),
}  # fmt: skip


@pytest.mark.parametrize(("text", "says"), BAD_CSV.values(), ids=BAD_CSV.keys())
def test_a_bad_csv_file_is_refused(text, says, tmp_path):
    path = tmp_path / "bad log.csv"
    path.write_text(text)
    with pytest.raises(LogError, match=says) as error:
        read_log(path)
    assert str(error.value).startswith(str(path))
    assert "\n" not in str(error.value)


def whole(extension, tmp_path):
    path = tmp_path / f"whole{extension}"
    if extension == ".mat":
        scipy.io.savemat(path, PLAIN)
    elif extension == ".73.mat":
        write_v73(path, PLAIN)
    else:
        pq.write_table(pa.table({name: pa.array(values) for name, values in COLUMNS.items()}), path)
    return path.read_bytes()


@pytest.mark.parametrize("extension", [".mat", ".73.mat", ".parquet"])
@pytest.mark.parametrize("kept", [0.0, 0.02, 0.5, 0.97])
def test_a_truncated_file_is_refused(extension, kept, tmp_path):
    path = tmp_path / f"log{extension}"
    data = whole(extension, tmp_path)
    path.write_bytes(data[: int(kept * len(data))])
    with pytest.raises(LogError, match=r"cut off|is empty|no column is called") as error:
        read_log(path)
    assert str(error.value).startswith(str(path))
    assert "\n" not in str(error.value)


WRONG = {
    "junk.csv": (np.random.default_rng(0).bytes(5000), "is binary, not text; if it is MAT, Parquet, HDF5"),
    "junk.mat": (np.random.default_rng(0).bytes(5000), "cannot be read as a MAT file"),
    "junk.parquet": (np.random.default_rng(0).bytes(5000), "cannot be read as Parquet"),
    "text.mat": ((NAMES + "\n" + rows()).encode(), "cannot be read as a MAT file"),
    "text.parquet": ((NAMES + "\n" + rows()).encode(), "cannot be read as Parquet"),
    "sheet.csv": (b"PK\x03\x04" + bytes(100), "Excel workbook"),
    "parquet.csv": (b"PAR1" + bytes(100), "name it .parquet"),
    "mat.csv": (b"MATLAB 5.0 MAT-file", "name it .mat"),
    "log.svdx": (b"x", r"unknown extension '\.svdx'; known: \.csv, .*\.mat.*\.parquet"),
    "log": (b"x", "unknown extension ''"),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_is_no_log_is_refused(name, tmp_path):
    content, says = WRONG[name]
    (tmp_path / name).write_bytes(content)
    with pytest.raises(LogError, match=says):
        read_log(tmp_path / name)


def test_a_folder_and_a_missing_file_are_refused(tmp_path):
    with pytest.raises(LogError, match="is a folder"):
        read_log(tmp_path)
    with pytest.raises(LogError, match=r"absent\.csv: no such file"):
        read_log(tmp_path / "absent.csv")
    with pytest.raises(LogError, match="no log is named"):
        read_logs([])


def test_arrays_of_another_length_are_refused_only_where_they_are_meant(tmp_path):
    path = tmp_path / "log.mat"
    scipy.io.savemat(path, PLAIN | {"spare": np.arange(7.0)})
    assert_is_the_log(read_log(path), exact=True)
    with pytest.raises(LogError, match="'spare' has 7 values, 'time' has 400"):
        read_log(path, mapping=ColumnMapping({"load": "spare"}))
    scipy.io.savemat(path, {"kp": 1.0, "name": "axis"})
    with pytest.raises(LogError, match=r"holds no arrays of numbers \('kp' holds a single value, 'name' holds text\)"):
        read_log(path)


LONG = 200_000  # characters, of a cell that no table of numbers has
STRANGE_CSV = {
    "a line of letters": (spoilt(57, "x" * LONG), "line 57 has 200000 characters, too many for one row of a table"),
    "a line of digits": (spoilt(57, "1" * LONG), "line 57 has 200000 characters, too many for one row"),
    "a header without end": (NAMES + "x" * LONG + "\n" + rows(), "line 1 has 2000.. characters, too many for one row"),
    "nothing but a line": ("1" * LONG, "line 1 has 200000 characters"),
    "400 digits": (
        spoilt(57, f"0.055,0.1,{'9' * 400},3"),
        r"line 57, column 'position': '9{40}\.\.\.9{17}' is larger than any double-precision number",
    ),
    "an exponent of 400": (spoilt(57, "0.055,0.1,1e400,3"), "'1e400' is larger than any double-precision number"),
    "400 digits in a time": (spoilt(57, f"{'9' * 400},0.1,2,3"), "line 57, column 'time': '9.*9' is larger than any"),
    "very many columns": (
        ",".join(f"positio{k}" for k in range(3000)) + "\n" + (",".join("1" * 3000) + "\n") * 4,
        r"the file has 3000 columns; near 'position' are 'positio\d', .*'$",
    ),
}


@pytest.mark.parametrize(("text", "says"), STRANGE_CSV.values(), ids=STRANGE_CSV.keys())
def test_a_csv_file_of_strange_size_is_refused_in_one_short_line(text, says, tmp_path):
    path = tmp_path / "log.csv"
    path.write_text(text)
    with pytest.raises(LogError, match=says) as error:
        read_log(path)
    assert len(str(error.value)) - len(str(path)) < 500


def test_infinity_in_words_still_stands_for_no_value(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text(spoilt(57, "0.055,0.1,inf,3"))
    assert "1 samples without a value were left out, which leaves 1 gaps" in read_log(path).notes


NO_SIGNALS = {
    "complex": (np.exp(1j * TIME), "holds complex numbers"),
    "text": ("0.1 0.2", "holds text"),
    "texts": (np.array(["a", "b"] * 200, dtype=object), "holds text"),
    "a single value": (3.0, "holds a single value"),
    "four dimensions": (np.zeros((2, 2, 2, 400)), "has 4 dimensions"),
}


@pytest.mark.parametrize(("value", "why"), NO_SIGNALS.values(), ids=NO_SIGNALS.keys())
def test_a_variable_that_is_no_signal_is_said_to_be_so(value, why, tmp_path):
    path = tmp_path / "log.mat"
    scipy.io.savemat(path, PLAIN | {"position": value})
    with pytest.raises(LogError, match=rf"'position' {why}, which is no signal"):
        read_log(path)
    with pytest.raises(LogError, match=rf"\[columns\] position = 'position': no such column; .*'position' {why}"):
        read_log(path, mapping=ColumnMapping({"position": "position"}))
    scipy.io.savemat(path, PLAIN | {"spare": value})
    said = (f"left out, since a signal is one number in each row: 'spare' {why}",)
    assert read_log(path).notes == (said if why not in ("holds text", "holds a single value") else ())


def test_a_column_of_lists_is_left_out_and_said(tmp_path):
    path = tmp_path / "log.parquet"
    lists = {"spare": pa.array([[0.0, 1.0]] * N), "pairs": pa.array([{"x": 1.0}] * N)}
    pq.write_table(pa.table({**{name: pa.array(values) for name, values in COLUMNS.items()}, **lists}), path)
    [said] = read_log(path).notes
    assert said == (
        "left out, since a signal is one number in each row: 'spare' holds a list<element: double> in each row, "
        "'pairs' holds a struct<x: double> in each row"
    )
    with pytest.raises(LogError, match=r"'spare' holds a list<element: double> in each row, which is no signal"):
        read_log(path, mapping=ColumnMapping({"load": "spare"}))


@pytest.mark.parametrize("extension", [".csv", ".parquet"])
def test_a_log_that_does_not_fit_is_refused_before_it_is_read(extension, tmp_path, monkeypatch):
    path = tmp_path / f"log{extension}"
    path.write_bytes(whole(".parquet", tmp_path)) if extension == ".parquet" else path.write_text(NAMES + "\n" + rows())
    read_log(path)
    monkeypatch.setattr("diffdrive.support.resources.memory_available", lambda: 3e4)
    with pytest.raises(
        LogError, match=r"log\.\w+: reading .* would take about .* kB of memory, and 30 kB are free: cut it"
    ):
        read_log(path)
