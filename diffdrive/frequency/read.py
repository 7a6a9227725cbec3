"""`read_frequency_response`: a measured frequency response from a file."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Complex, Float

from diffdrive.errors import LogError, ParameterError
from diffdrive.frequency.columns import response_of_table
from diffdrive.frequency.response import FrequencyResponse, require_known
from diffdrive.frequency.servo_tuning_file import UNIT, read_servo_tuning
from diffdrive.logs.formats.csv_file import read_csv
from diffdrive.support.bounds import require_count


def read_frequency_response(
    path: str | Path,
    of: str | None = None,
    *,
    unit: str | None = None,
    columns: Mapping[str, str] | None = None,
    units: Mapping[str, str] | None = None,
    record: int | None = None,
) -> FrequencyResponse:
    """Read a measured frequency response from a CSV file, or from the XML of SINUMERIK's auto servo tuning.

    A CSV file has the columns frequency (Hz or rad/s), and magnitude (dB or a ratio) and phase (deg or rad), or real
    and imaginary; a column coherence where it was measured. Units stand behind the names in brackets. The XML holds the
    response from the motor's torque to its speed, the current loop taken out: a "plant" in (rad/s)/(N*m).

    Args:
        path: The file, .xml or any text table.
        of: What the response is of, as `FrequencyResponse` says; the XML says it itself.
        unit: Of a plant, such as "(rad/s)/(N*m)" or "(m/s)/N"; dB are those of this unit. Behind a linear motor the XML
            is in "(m/s)/N": say so.
        columns: The column of each quantity, such as `{"magnitude": "Ampl1"}`.
        units: The unit of a quantity's column, such as `{"frequency": "Hz", "magnitude": "dB"}`.
        record: Which measurement of an XML that holds several, counted from 1.

    Raises:
        LogError: The file cannot be read: one line that names the file, the column or field, and the remedy.
        ParameterError: It is not said what the response is of, or in which unit.

    Examples:
        >>> measured = read_frequency_response("speed_plant.csv", "plant", unit="(rad/s)/(N*m)")
        >>> measured = read_frequency_response("AST_X1.xml")

    """
    file = Path(path)
    if not file.is_file():
        raise LogError(f"{file}: {'is a folder, not a file' if file.is_dir() else 'no such file; check the path'}")
    if file.suffix.lower() == ".xml":
        if columns or units:
            raise ParameterError(f"{file}: columns, units: are those of a text table; an XML says them itself")
        return _from_xml(file, of, unit, record)
    if record is not None:
        raise ParameterError(f"{file}: record: is that of an XML; a text table holds one response")
    require_known(of)
    assert of is not None
    frequency, value, coherence = response_of_table(read_csv(file), columns or {}, units or {})
    return _checked(file, frequency, value, of, unit or "1", coherence)


def _from_xml(file: Path, of: str | None, unit: str | None, record: int | None) -> FrequencyResponse:
    if of not in (None, "plant"):
        raise ParameterError(f"{file}: of: the XML of auto servo tuning holds a 'plant', not {of!r}; leave it out")
    records = read_servo_tuning(file)
    if record is None and len(records) > 1:
        raise ParameterError(f"{file}: holds {len(records)} measurements; say which, as record=1 to {len(records)}")
    place = 1 if record is None else record
    require_count("record", place, 1)
    if place > len(records):
        raise ParameterError(f"{file}: record: there are {len(records)}, got {place}")
    frequency, value, coherence = records[place - 1]
    return _checked(file, frequency, value, "plant", unit or UNIT, coherence)


def _checked(
    file: Path,
    frequency: Float[np.ndarray, " f"],
    value: Complex[np.ndarray, " f"],
    of: str,
    unit: str,
    coherence: Float[np.ndarray, " f"] | None,
) -> FrequencyResponse:
    """The response without what a Fourier transform writes first; what is wrong with it names the file."""
    keep = frequency != 0.0
    notes = () if keep.all() else ("the value at 0 Hz was left out",)
    kept = None if coherence is None else coherence[keep]
    try:
        return FrequencyResponse(frequency[keep], value[keep], of, unit, kept, file.stem, notes)
    except ParameterError as problem:
        raise LogError(f"{file}: {str(problem).removeprefix(f'{file.stem}: ')}") from None
