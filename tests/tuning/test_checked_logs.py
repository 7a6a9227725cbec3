"""Which log a load is of: a name that fits none of them, or several, is refused."""

from pathlib import Path

import numpy as np
import pytest

import tuning
from diffdrive.errors import ParameterError
from diffdrive.logs import write_log
from tests.support.sound_log import DRIVE, SOUND
from tuning.checked_logs import CheckedLogs, which_log

FILES = [Path("a/lap.csv"), Path("b/lap.csv"), Path("run"), Path("run.1")]
FRAME = dict(SOUND.channels)


NAMED = {"a/lap": 0, "a/lap.csv": 0, "b/lap.csv": 1, "c/../b/lap.csv": 1, "run": 2, "run.1": 3}
UNCLEAR = {
    "lap": "names 2 logs, a/lap.csv, b/lap.csv: write the folder, too",
    "lpa.csv": "no such log; did you mean 'lap",
    "c/lap": "no such log",
    "": "no such log",
}


@pytest.mark.parametrize("key", NAMED)
def test_a_log_is_named_as_in_shifts(key):
    assert which_log(key, FILES, "loads") == NAMED[key]


@pytest.mark.parametrize("key", UNCLEAR)
def test_a_name_of_no_log_or_of_several_is_refused(key):
    with pytest.raises(ParameterError, match=f"^loads: {UNCLEAR[key]}"):
        which_log(key, FILES, "loads")


@pytest.mark.parametrize("call", [tuning.identify, tuning.diagnose])
def test_a_load_of_a_log_that_is_not_there_is_refused(call):
    with pytest.raises(ParameterError, match="loads: 'lap_1': no such log; did you mean 'lap1'"):
        call(DRIVE, SOUND.replace(name="lap1"), loads={"lap_1": 8e3})


def test_data_frames_have_names_of_their_own():
    with pytest.raises(ParameterError, match=r"no such log; did you mean 'log[12]'"):
        tuning.identify(DRIVE, [FRAME, FRAME], loads={"log": 8e3})


def test_a_log_is_given_one_load_and_a_held_out_one_is_told_from_it(tmp_path):
    write_log(tmp_path / "lap1.csv", SOUND)
    with pytest.raises(ParameterError, match=r"'lap1': .*is given two loads"):
        tuning.identify(DRIVE, tmp_path / "lap1.csv", loads={"lap1.csv": 8e3, "lap1": 8e3})
    other = SOUND.replace(name="lap", position=np.roll(SOUND.position, 1))
    with pytest.raises(ParameterError, match="loads: 'lap': names 2 logs"):
        tuning.identify(DRIVE, SOUND.replace(name="lap"), held_out=other, loads={"lap": 8e3})


@pytest.mark.parametrize(("argument", "value"), [("starts", 0), ("starts", 2.5), ("seed", -1)])
def test_a_search_that_cannot_be_is_refused_by_name_before_a_log_is_read(argument, value):
    with pytest.raises(ParameterError, match=f"{argument}: must be a whole number from .*, got {value}"):
        tuning.identify(DRIVE, "no such log.csv", **{argument: value})


@pytest.mark.parametrize(
    ("call", "engine"),
    [
        (tuning.identify, "tuning.identification.workflow.fit_drive"),
        (tuning.diagnose, "tuning.diagnosis.workflow.diagnose_drive"),
    ],
)
def test_what_is_finished_is_kept_in_the_folder_to_resume_from(call, engine, monkeypatch, tmp_path):
    stores = []

    def stopped(*given, store, **more):
        stores.append(store)
        raise KeyboardInterrupt

    monkeypatch.setattr(engine, stopped)
    for folder in (tmp_path / "parts", str(tmp_path / "parts"), None):
        with pytest.raises(KeyboardInterrupt):
            call(DRIVE, CheckedLogs((SOUND,), ()), resume=folder)
    assert [store and store.folder for store in stores] == [tmp_path / "parts", tmp_path / "parts", None]
