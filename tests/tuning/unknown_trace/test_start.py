"""From a CSV to a drive file: what is stated is kept, friction is that of the machine, and the log passes the check."""

import json

import numpy as np
import pytest

import tuning
from diffdrive.axis_file.drive_file import read_axis
from diffdrive.errors import DriveFileError, ParameterError, ResultError
from diffdrive.logs import write_log
from diffdrive.logs.checks.dynamics import ACCURACY
from tests.support.cnc_axis import CncAxis, log_of
from tests.support.sound_log import DRIVE, SOUND

LEAD, RATED = 0.01, 5.0  # m, N m
COLUMNS = {
    "Zeit [ms]": 1e3 * SOUND.time,
    "Lagesollwert [mm]": 1e3 * SOUND.reference,
    "Lageistwert [mm]": 1e3 * SOUND.position,
    "Momentensollwert [%]": -100.0 * SOUND.command * LEAD / (2 * np.pi) / RATED,
}
STATED = {"mass": "110 kg", "lead": "10 mm", "rated_torque": "5 Nm"}


def written_csv(path, columns, separator=";", decimal=","):
    rows = np.column_stack(list(columns.values()))
    lines = [separator.join(f"{value:.9g}" for value in row).replace(".", decimal) for row in rows]
    path.write_text("\n".join([separator.join(columns), *lines]) + "\n", encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def trace(tmp_path_factory):
    return written_csv(tmp_path_factory.mktemp("trace") / "trace.csv", COLUMNS)


@pytest.fixture(scope="module")
def started(trace):
    return tuning.start(trace, **STATED)


def test_what_is_stated_is_kept(started):
    assert started.status.ok
    assert started.axis.value("plant.mass") == 110.0
    assert (started.axis.sheet.lead, started.axis.sheet.rated_torque) == (LEAD, RATED)
    assert started.axis.mapping.units["command"] == "-%"


def test_friction_is_that_of_the_machine_as_far_as_a_balance_of_forces_goes(started):
    """`ACCURACY` is what the balance can be off on sound logs; beside it twice the standard error that it states.

    A drag that differs by direction is no part of the guess: its mean is compared, and its difference, over the speeds
    of the log, is what the guess has for a constant force.
    """
    friction, truth = started.axis.drive.friction, DRIVE.drive
    errors = started.machine.found.standard_errors
    level = truth.friction.coulomb_at(0.0)
    coulomb = 0.5 * (float(level.positive) + float(level.negative))
    assert float(friction.coulomb_screw.positive) == pytest.approx(
        coulomb, abs=ACCURACY * coulomb + 2.0 * errors["coulomb"]
    )
    drag = truth.friction.viscous + truth.plant.damping
    viscous = 0.5 * (float(drag.positive) + float(drag.negative))
    assert float(friction.viscous.positive) == pytest.approx(viscous, abs=ACCURACY * viscous + 2.0 * errors["viscous"])
    assert started.implied_mass == pytest.approx(100.0, rel=ACCURACY)


def test_the_controller_is_the_one_that_ran(started):
    assert started.axis.controller.kind == "pd"
    for name, gain in DRIVE.gains.items():
        assert float(started.axis.gains[name]) == pytest.approx(float(gain), rel=1e-3)


def test_the_log_passes_the_check_with_the_drive_file(started):
    assert started.findings.notable == []


def test_the_file_reads_back_to_the_axis_and_is_never_overwritten(started, tmp_path):
    path = started.write(tmp_path / "drive.toml")
    assert read_axis(path).parameters == started.axis.parameters
    before = path.read_bytes()
    with pytest.raises(DriveFileError, match="exists, and is not overwritten: remove it, or name another file"):
        started.write(path)
    assert path.read_bytes() == before
    dangling = tmp_path / "link.toml"
    dangling.symlink_to(tmp_path / "nowhere")
    with pytest.raises(DriveFileError, match="exists"):
        started.write(dangling)
    with pytest.raises(DriveFileError, match="cannot be written"):
        started.write(tmp_path / "nowhere" / "drive.toml")


def test_each_value_of_the_file_says_where_it_is_from(started):
    lines = [line for line in started.text.splitlines() if "=" in line and not line.startswith("#")]
    silent = [line for line in lines if "#" not in line and not line.startswith("time = ")]
    assert silent == []


def test_it_is_a_result_as_all_others(started, tmp_path):
    assert "friction: " in started.summary()
    assert json.loads(started.save(tmp_path).read_text())["schema"] == "start/1"


def test_what_is_open_is_said_at_once_and_in_one_line(trace, tmp_path):
    result = tuning.start(trace)
    assert (result.status.ok, result.status.code, result.text, result.axis) == (False, "open questions", None, None)
    for option in ('--mass "500 kg"', '--lead "10 mm"', '--rated-torque "5 N*m"'):
        assert option in result.status.message
    assert "\n" not in result.status.message
    with pytest.raises(ResultError, match="--mass"):
        tuning.start(trace, throw=True)
    with pytest.raises(DriveFileError, match="there is no drive file yet"):
        result.write(tmp_path / "drive.toml")


def test_a_trace_that_shows_its_own_mass_says_so(trace):
    result = tuning.start(trace, lead=LEAD, rated_torque=RATED)
    assert [question.argument for question in result.questions] == ["mass"]
    assert "the trace itself shows 100 kg" in result.questions[0].why


@pytest.mark.parametrize(
    ("stated", "says"),
    [({"mass": -1.0}, "mass"), ({"lead": 0.0}, "lead"), ({"kind": "round"}, "kind"), ({"mass": "5 m"}, "mass")],
)
def test_a_number_out_of_its_range_is_refused(trace, stated, says):
    with pytest.raises((ParameterError, ValueError), match=says):
        tuning.start(trace, **stated)


def test_a_mass_that_the_trace_contradicts_is_said(trace):
    result = tuning.start(trace, **STATED | {"mass": "500 kg"})
    assert result.axis.value("plant.mass") == 500.0
    assert any("the trace shows a moving mass of 100" in note for note in result.notes)


def test_two_encoders_become_two_encoders():
    log = log_of(CncAxis(backlash=100e-6), seconds=6.0)
    result = tuning.start(
        {
            "t [s]": log.time, "cmd pos [mm]": 1e3 * log.reference, "scale [mm]": 1e3 * log.position,
            "motor pos [rev]": log.motor_position / LEAD, "torque set [Nm]": log.command * LEAD / (2 * np.pi),
        },
        mass=500.0,
    )  # fmt: skip
    drive = result.axis.drive
    assert float(drive.sensor.resolution) == pytest.approx(0.5e-6, rel=1e-3)
    assert drive.motor_encoder is not None
    assert result.axis.sheet.lead == pytest.approx(LEAD, rel=2e-3)
    assert result.axis.controller.kind == "unknown"


def test_a_fit_can_begin_from_the_drive_file(started):
    """Each friction that `identify` looks for about the file's is above zero."""
    friction = started.axis.drive.friction
    for name in ("coulomb_screw", "load_coefficient", "viscous", "bristle_stiffness", "bristle_damping"):
        assert float(getattr(friction, name).positive) > 0.0, name


@pytest.mark.long
def test_the_drive_file_is_identified_from(started, trace):
    found = tuning.identify(started.axis, trace, starts=1)
    assert found.estimate("mass").value == pytest.approx(100.0, rel=ACCURACY)


def test_a_log_with_every_digit_of_the_command_finds_the_controller_too(tmp_path):
    """Its moments are worth 1e17 of what was expected: their curvature must not be lost to rounding."""
    write_log(tmp_path / "lap.csv", SOUND)
    found = tuning.start(tmp_path / "lap.csv", mass="100 kg")
    assert found.axis.controller.kind == "pd"
    for name, gain in DRIVE.gains.items():
        assert found.axis.gains[name] == pytest.approx(float(gain), rel=1e-6)
