"""A two-mass plant written as CSV in every way, and as the XML of auto servo tuning, is read back as it was."""

import numpy as np
import pytest

import diffdrive as dd
from diffdrive.errors import LogError, ParameterError
from tests.support import servo_tuning_xml as xml
from tests.support.second_order import two_mass_speed

FREQUENCY = np.geomspace(2.0, 2_000.0, 300)
PLANT = two_mass_speed(FREQUENCY)
COHERENCE = np.linspace(0.5, 1.0, 300)
DECIBELS, DEGREES = 20.0 * np.log10(np.abs(PLANT)), np.degrees(np.angle(PLANT))
UNIT = "(m/s)/N"


def written(path, header, *columns, delimiter=",", decimal="."):
    rows = (
        delimiter.join(f"{value:.15g}".replace(".", decimal) for value in row) for row in zip(*columns, strict=True)
    )
    path.write_text("\n".join([header, *rows]) + "\n", encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("header", "columns", "style"),
    [
        ("Frequency [Hz],Magnitude [dB],Phase [deg]", (FREQUENCY, DECIBELS, DEGREES), {}),
        ("f (Hz);Betrag (dB);Phase (°)", (FREQUENCY, DECIBELS, DEGREES), {"delimiter": ";", "decimal": ","}),
        ("omega [rad/s],gain [1],phase [rad]", (2 * np.pi * FREQUENCY, np.abs(PLANT), np.angle(PLANT)), {}),
        ("freq [kHz]\tre\tim", (FREQUENCY / 1e3, PLANT.real, PLANT.imag), {"delimiter": "\t"}),
    ],
    ids=["dB and degrees", "decimal comma", "ratio and radians", "real and imaginary"],
)
def test_a_plant_in_a_text_table_is_read_back(tmp_path, header, columns, style):
    read = dd.read_frequency_response(written(tmp_path / "plant.csv", header, *columns, **style), "plant", unit=UNIT)
    np.testing.assert_allclose(read.frequency, FREQUENCY, rtol=1e-12)
    np.testing.assert_allclose(read.value, PLANT, rtol=1e-12)
    assert (read.of, read.unit, read.coherence, read.name) == ("plant", UNIT, None, "plant")


def test_columns_and_units_may_be_said(tmp_path):
    path = written(tmp_path / "a.csv", "x,Ampl1,Ph1,coherence", FREQUENCY, DECIBELS, DEGREES, COHERENCE)
    columns = {"frequency": "x", "magnitude": "Ampl1", "phase": "Ph1"}
    units = {"frequency": "Hz", "magnitude": "dB", "phase": "deg"}
    read = dd.read_frequency_response(path, "speed-loop", columns=columns, units=units)
    np.testing.assert_allclose(read.value, PLANT, rtol=1e-12)
    np.testing.assert_allclose(read.coherence, COHERENCE, rtol=1e-12)


def test_a_value_at_zero_is_left_out_and_said(tmp_path):
    path = written(
        tmp_path / "a.csv", "f [Hz],re,im", np.r_[0.0, FREQUENCY], np.r_[0.0, PLANT.real], np.r_[0.0, PLANT.imag]
    )
    read = dd.read_frequency_response(path, "open-loop")
    np.testing.assert_allclose(read.value, PLANT, rtol=1e-12)
    assert read.notes == ("the value at 0 Hz was left out",)


def test_the_xml_of_auto_servo_tuning_is_read_to_the_last_bit(tmp_path):
    path = tmp_path / "AST_AX1.xml"
    path.write_text(xml.document(xml.record(FREQUENCY, PLANT, COHERENCE)), encoding="latin-1")
    read = dd.read_frequency_response(path)
    for got, expected in ((read.frequency, FREQUENCY), (read.value, PLANT), (read.coherence, COHERENCE)):
        np.testing.assert_array_equal(got, expected)
    assert (read.of, read.unit) == ("plant", "(rad/s)/(N*m)")


def test_of_several_measurements_one_is_asked_for(tmp_path):
    path = tmp_path / "two.xml"
    both = (xml.record(FREQUENCY, factor * PLANT, COHERENCE) for factor in (1.0, 2.0))
    path.write_text(xml.document(*both), encoding="latin-1")
    with pytest.raises(ParameterError, match=r"two\.xml: holds 2 measurements; say which, as record=1 to 2"):
        dd.read_frequency_response(path)
    np.testing.assert_array_equal(dd.read_frequency_response(path, record=2).value, 2.0 * PLANT)


def test_words_of_zero_are_points():
    assert xml.base85(np.array([1.0])) == xml.base85(np.array([1.0]))[:5] + "."


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (xml.document(), "holds no measured response of the mechanical system; save it after"),
        (
            xml.document(root="traceSession"),
            "is XML of another kind, 'traceSession'; a result of SINUMERIK's auto servo",
        ),
        (xml.document(xml.record(FREQUENCY, PLANT, COHERENCE))[:9_000], "is another format or cut off"),
        (xml.document(xml.record(FREQUENCY, PLANT, COHERENCE)).replace("base85", "CSV"), "in the format 'CSV'; base85"),
        (
            xml.document(xml.record(FREQUENCY, PLANT, COHERENCE)).replace('Array">', 'Array">&gt;'),
            r"m_FrequencyVector: '>.*' is no number in base 85",
        ),
        (
            xml.document(xml.record(FREQUENCY, PLANT[:-1], COHERENCE)),
            "m_pPlant: has 598 numbers for 300 complex values; save it again",
        ),
        (
            xml.document(xml.record(FREQUENCY[::-1], PLANT, COHERENCE)),
            "frequency: must be above 0 and rise from each value to the next",
        ),
    ],
)
def test_an_xml_that_cannot_be_read_says_why(tmp_path, text, says):
    path = tmp_path / "AST.xml"
    path.write_text(text, encoding="latin-1")
    with pytest.raises(LogError, match=rf"AST\.xml: .*{says}"):
        dd.read_frequency_response(path)


FEW = (FREQUENCY[:5], DECIBELS[:5], DEGREES[:5])


@pytest.mark.parametrize(
    ("header", "columns", "says"),
    [
        ("f [Hz],magnitude,phase [deg]", FEW, r"'magnitude': does not say the unit of the magnitude: write dB or 1"),
        ("f,magnitude [dB],phase [deg]", FEW, r"'f': does not say the unit of the frequency: write hz, khz or rad/s"),
        ("f [rpm],magnitude [dB],phase [deg]", FEW, r"'f \[rpm\]': 'rpm' is no unit of the frequency"),
        (
            "f [Hz],magnitude [dB],x",
            FEW,
            r"needs the columns magnitude and phase, or real and imaginary; has 'f \[Hz\]'",
        ),
        ("f [Hz],gain [dB],amplitude [dB]", FEW, r"'gain \[dB\]' and 'amplitude \[dB\]' may both be the magnitude"),
        (
            "f [Hz],gain [1],phase [deg]",
            FEW,
            r"'gain \[1\]': line 2 is below 0, as no ratio is; if it is in dB, say so",
        ),
        (
            "f [Hz],gain [dB],phase [deg]",
            [one[::-1] for one in FEW],
            r"line 3 is not above the one before; sort by freq",
        ),
        ("f [Hz],gain [dB],phase [deg]", [one[:3] for one in FEW], r"must be arrays of one length, 4 or more"),
        ("f [Hz],gain [dB],phase [deg],coherence", [*FEW, 2.0 + FEW[0]], r"coherence: must be from 0 to 1"),
    ],
)
def test_a_text_table_that_cannot_be_read_says_why(tmp_path, header, columns, says):
    path = written(tmp_path / "bad.csv", header, *columns)
    with pytest.raises(LogError, match=rf"bad\.csv: .*{says}"):
        dd.read_frequency_response(path, "plant", unit=UNIT)


def test_what_it_is_of_must_be_said(tmp_path):
    path = written(tmp_path / "a.csv", "f [Hz],gain [dB],phase [deg]", *FEW)
    with pytest.raises(
        ParameterError, match="of: say what the response is of, got None; one of 'plant', from the torque"
    ):
        dd.read_frequency_response(path)
    with pytest.raises(LogError, match=r"a\.csv: unit: a plant has a unit: state it, such as '\(rad/s\)/\(N\*m\)'"):
        dd.read_frequency_response(path, "plant")
    with pytest.raises(LogError, match=r"no such file; check the path"):
        dd.read_frequency_response(tmp_path / "none.csv", "plant")
    path = tmp_path / "a.xml"
    path.write_text("<a/>")
    with pytest.raises(ParameterError, match=r"of: the XML of auto servo tuning holds a 'plant', not 'open-loop'"):
        dd.read_frequency_response(path, "open-loop")


def test_a_plant_of_the_motor_becomes_one_of_the_table_by_the_data_sheet():
    measured = dd.FrequencyResponse(FREQUENCY, PLANT, "plant", "(rad/s)/(N*m)")
    travel = 10e-3 / (2.0 * np.pi)
    np.testing.assert_allclose(measured.at_table(dd.DataSheet(lead=10e-3)), travel**2 * PLANT, rtol=1e-12)
    with pytest.raises(ParameterError, match=r"unit: \[axis\] lead is needed to read"):
        measured.at_table(dd.DataSheet())
    with pytest.raises(ParameterError, match=r"unit: .* has the wrong unit"):
        dd.FrequencyResponse(FREQUENCY, PLANT, "plant", "N/m").at_table(dd.DataSheet())
