"""Reads the XML of SINUMERIK's auto servo tuning: the measured response of the mechanical system, and its coherence.

    DynamicModelAxisController ... PlantMeasRecord
        FrequencyResponseFunction m_pPlant           torque of the motor -> speed of the motor, rad/s per N m
        FrequencyResponseFunction m_pMeasCoherence
            NumericArray m_FrequencyVector (Hz), m_ValueVector (re, im, re, im, ...): doubles as text in base 85

A double is two words of 32 bits, the higher first; a word is five digits, or a point where it is zero. The alphabet of
the digits was published with https://github.com/eliasrhoden/Trace-Tools.
"""

from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np
from jaxtyping import Complex, Float

from diffdrive.errors import LogError
from diffdrive.logs.formats.optional import first_line, unreadable
from diffdrive.support.messages import shortened
from diffdrive.support.resources import format_bytes, require_memory

IN_MEMORY = 8.0  # bytes for each of the file
ROOT, RECORD = "DynamicModelAxisController", "PlantMeasRecord"
RESPONSE, PLANT, COHERENCE = "FrequencyResponseFunction", "m_pPlant", "m_pMeasCoherence"
VALUES, FREQUENCIES = "m_ValueVector", "m_FrequencyVector"
UNIT = "(rad/s)/(N*m)"
WHAT = "a result of SINUMERIK's auto servo tuning"
_DIGITS = "0123456789abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ!#$`()*+-/:;=?@[]^_{|}~"
_ZERO, _WORD, _BASE = ".", 5, 85
_VALUE_OF = {digit: value for value, digit in enumerate(_DIGITS)}


class PlantRecord(NamedTuple):
    """One measurement of the mechanical system."""

    frequency: Float[np.ndarray, " f"]  # Hz
    value: Complex[np.ndarray, " f"]  # rad/s per N m of the motor
    coherence: Float[np.ndarray, " f"] | None


def read_servo_tuning(path: Path) -> list[PlantRecord]:
    """Every measured plant of the file; raises `LogError` if it is no such file, is cut off, or holds none."""
    size = path.stat().st_size
    require_memory(LogError, f"{path}: reading {format_bytes(size)} of XML", IN_MEMORY * size, "save one axis alone")
    records: list[PlantRecord] = []
    depth, inside = 0, 0  # elements that are open, and how many were when a record began
    try:
        for event, element in ElementTree.iterparse(path, events=("start", "end")):
            if event == "start":
                depth += 1
                if depth == 1 and element.tag != ROOT:
                    raise LogError(
                        f"{path}: is XML of another kind, '{shortened(element.tag)}'; {WHAT} begins with '{ROOT}'; "
                        "export anything else as CSV"
                    )
                inside = inside or (depth if element.tag == RECORD else 0)
                continue
            if inside == depth:
                records += _record(path, element)
                inside = 0
            if not inside:
                element.clear()
            depth -= 1
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        if isinstance(error, LogError):
            raise
        raise unreadable(path, WHAT, first_line(error)) from None
    if not records:
        raise LogError(f"{path}: holds no measured response of the mechanical system; save it after the measurement")
    return records


def _record(path: Path, element: ElementTree.Element) -> list[PlantRecord]:
    """The measurement that an element holds; none where it holds a model (a transfer function) in its place."""
    found = {one.get("name"): one for one in element.findall(RESPONSE)}
    if PLANT not in found:
        return []
    frequency, value = _response(path, found[PLANT], PLANT)
    if COHERENCE not in found:
        return [PlantRecord(frequency, value, None)]
    at, coherence = _response(path, found[COHERENCE], COHERENCE)
    if not np.array_equal(at, frequency):
        raise LogError(f"{path}: {COHERENCE}: is at other frequencies than {PLANT}; save the measurement again")
    return [PlantRecord(frequency, value, coherence.real)]


def _response(
    path: Path, element: ElementTree.Element, name: str
) -> tuple[Float[np.ndarray, " f"], Complex[np.ndarray, " f"]]:
    arrays = {array.get("name"): array for array in element.findall("NumericArray")}
    for wanted in (VALUES, FREQUENCIES):
        if wanted not in arrays:
            raise LogError(f"{path}: {name}: has no {wanted}; save the measurement again")
    frequency = _doubles(path, arrays[FREQUENCIES], name)
    pairs = _doubles(path, arrays[VALUES], name)
    if len(pairs) != 2 * len(frequency):
        raise LogError(f"{path}: {name}: has {len(pairs)} numbers for {len(frequency)} complex values; save it again")
    return frequency, pairs[0::2] + 1j * pairs[1::2]


def _doubles(path: Path, array: ElementTree.Element, name: str) -> Float[np.ndarray, " n"]:
    """The numbers of an array."""
    layout = array.get("format", "")
    if layout != "base85":
        raise LogError(f"{path}: {name}: {array.get('name')} is in the format '{shortened(layout)}'; base85 is read")
    raw = array.find("raw")
    text = "".join((raw.text or "").split()) if raw is not None else ""
    words: list[int] = []
    at = 0
    while at < len(text):
        digits = _ZERO if text[at] == _ZERO else text[at : at + _WORD]
        word = 0 if digits == _ZERO else _word(digits)
        if word is None:
            raise LogError(
                f"{path}: {name}: {array.get('name')}: '{shortened(digits)}' is no number in base 85; save it again"
            )
        words.append(word)
        at += len(digits)
    if len(words) % 2:
        raise LogError(f"{path}: {name}: {array.get('name')} ends within a number; save the measurement again")
    return np.array(words, ">u4").view(">f8").astype(float)


def _word(digits: str) -> int | None:
    """The 32 bits that five digits are; None where they are none."""
    if len(digits) != _WORD or any(digit not in _VALUE_OF for digit in digits):
        return None
    number = 0
    for digit in digits:
        number = _BASE * number + _VALUE_OF[digit]
    return number if number < 2**32 else None
