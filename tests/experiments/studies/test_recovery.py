"""The study of recovery: its summary of made-up draws, and that it goes on where it was stopped."""

import json
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from diffdrive.model.presets import paper_drive
from diffdrive.model.quantity import Directional
from experiments.studies.recovery import study as recovery


def row(name, true=10.0, value=10.0, half=0.5, status="fitted"):
    return {"name": name, "true": true, "value": value, "low": value - half, "high": value + half, "status": status}


def made_up(number, *rows):
    return {"draw": number, "status": "converged", "seconds": 1.0, "simulations": 100, "rows": list(rows)}


DONE = [
    made_up(0, row("mass", value=10.1), row("viscous.positive", value=9.0), row("viscous.negative", 20.0, 20.4)),
    made_up(1, row("mass", value=10.3), row("viscous.positive", value=10.4), row("viscous.negative", status="fixed")),
    made_up(2, row("mass", value=9.0), row("viscous.positive", status="not determined"), row("delay", 0.0, 0.1)),
]  # fmt: skip


def test_the_summary_counts_errors_coverage_and_what_stayed_open():
    table = {name: rest for name, *rest in recovery.summary(DONE)}
    draws, median, most, worst, bar, met, inside, lost, stopped = table["mass"]
    assert (draws, lost, stopped) == (3, 0, 0)
    assert median == pytest.approx(3.0)
    assert worst == pytest.approx(10.0)
    assert median < most < worst
    assert (bar, met) == (2.0, pytest.approx(100.0 / 3))
    assert inside == pytest.approx(100.0 * 2 / 3)
    draws, median, _, worst, _, met, inside, lost, _ = table["viscous"]  # both directions together
    assert (draws, lost) == (5, 1)
    assert (median, worst, met) == (pytest.approx(4.0), pytest.approx(10.0), 0.0)
    assert inside == pytest.approx(100.0 * 2 / 3)
    draws, median, *_, inside, _, _ = table["delay"]  # a truth of zero has no error in percent
    assert (draws, median, inside) == (1, None, 100.0)


def test_coverage_is_over_fitted_parameters_alone():
    assert recovery.coverage(DONE) == (5, 7)


def test_a_parameter_that_was_never_fitted_has_neither_error_nor_coverage():
    only = made_up(0, row("mass", status="not determined"))
    ((name, draws, *errors, _, _, inside, lost, _),) = recovery.summary([only])
    assert (name, draws, lost) == ("mass", 1, 1)
    assert errors == [None] * 3
    assert inside is None


def test_what_ran_to_its_bound_or_failed_counts_against_the_bar_and_the_coverage():
    failed = {"name": "mass", "true": 10.0, "status": "failed"}
    done = [made_up(0, row("mass")), made_up(1, row("mass", value=10.01, status="at its bound")), made_up(2, failed)]
    ((*_, worst, _, met, inside, lost, stopped),) = recovery.summary(done)
    assert (worst, lost, stopped) == (0.0, 0, 1)
    assert (met, inside) == (pytest.approx(100.0 / 3), pytest.approx(100.0 / 3))
    assert recovery.coverage(done) == (1, 3)


def test_what_should_be_found_is_the_drive_itself_with_the_believed_damping():
    drive = paper_drive()
    values = recovery.true_values(drive, drive)
    assert values["coulomb_at_no_load.positive"] == pytest.approx(63.43 + 3.66e-4 * 15_200)
    assert (values["viscous.positive"], values["viscous.negative"]) == (1826.5, 1673.5)
    undamped = type(drive)(type(drive.plant)(100.0, Directional(0.0, 0.0)), drive.friction)
    moved = recovery.true_values(drive, undamped)
    assert moved["viscous.positive"] == pytest.approx(1826.5 + 380.0)


def kept(path, *done):
    path.write_text("".join(json.dumps(one) + "\n" for one in done), encoding="utf-8")


@pytest.fixture
def drawn(monkeypatch):
    """The draws that are computed, in place of the computation; in threads, which see the replacement."""
    computed = []

    def draw(number):
        computed.append(number)
        return made_up(number, row("mass"))

    monkeypatch.setattr(recovery, "identify_draw", draw)
    monkeypatch.setattr(recovery, "processes", ThreadPoolExecutor)
    return computed


def test_a_study_that_is_complete_computes_nothing(tmp_path, drawn):
    path = tmp_path / "draws.jsonl"
    kept(path, *DONE)
    before = path.read_bytes()
    assert list(recovery.identify_draws(3, path, 2)) == DONE
    assert list(recovery.identify_draws(2, path, 2)) == DONE[:2]
    assert drawn == []
    assert path.read_bytes() == before


def test_a_study_goes_on_with_what_is_missing(tmp_path, drawn):
    path = tmp_path / "draws.jsonl"
    kept(path, DONE[2], DONE[0])
    found = list(recovery.identify_draws(5, path, 2))
    assert found[:2] == [DONE[2], DONE[0]]
    assert sorted(drawn) == [1, 3, 4]
    again = list(recovery.identify_draws(5, path, 2))
    assert sorted(one["draw"] for one in again) == [0, 1, 2, 3, 4]
    assert sorted(drawn) == [1, 3, 4]


@pytest.mark.parametrize("cut", [1, 2, 60])
def test_a_line_that_a_kill_cut_short_is_computed_again(tmp_path, drawn, cut):
    path = tmp_path / "draws.jsonl"
    kept(path, *DONE)
    path.write_bytes(path.read_bytes()[:-cut])
    found = list(recovery.identify_draws(3, path, 2))
    assert found[:2] == DONE[:2]
    assert [one["draw"] for one in found] == [0, 1, 2]
    assert drawn == [2]
    assert len([json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]) == 3


def test_a_file_in_which_not_even_the_first_line_is_whole_begins_anew(tmp_path, drawn):
    path = tmp_path / "draws.jsonl"
    path.write_text('{"draw": 0, "sta', encoding="utf-8")
    assert [one["draw"] for one in recovery.identify_draws(1, path, 1)] == [0]
    assert drawn == [0]


def test_the_study_writes_its_tables(tmp_path, drawn):
    recovery.study(tmp_path, count=3, workers=1)
    assert np.array_equal(sorted(drawn), [0, 1, 2])
    assert (tmp_path / "draws.jsonl").exists()
    assert any(path.stem == "recovery" for path in tmp_path.iterdir())
