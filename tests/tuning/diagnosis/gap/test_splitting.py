"""What a ladder fits to and what it is judged by: motion on both sides, and every number told by what is fitted."""

from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

from tuning.diagnosis.gap.splitting import split
from tuning.diagnosis.hypotheses.calibration import NAMES
from tuning.diagnosis.hypotheses.model import Model

RATE = 1_000.0
WAVE = SimpleNamespace(candidate=SimpleNamespace(parameters=(SimpleNamespace(name="cosine", amplitude=True),)))


def of(velocity, tells, slots, nominal=1.0, members=()):
    """A fit to lanes that move at these velocities (m/s), one log each; `tells` [lanes, n, slots] of the jacobian,
    `nominal` that of the drive's own numbers.
    """
    velocity, tells = np.asarray(velocity, float), np.asarray(tells, float)
    lanes, samples = velocity.shape
    own = np.broadcast_to(nominal, (lanes, samples, len(NAMES)))
    jacobian = np.concatenate([own, tells], axis=2)
    logged = SimpleNamespace(
        lanes=SimpleNamespace(counts=np.ones((lanes, samples))),
        owner=tuple(range(lanes)),
        logs=lanes,
        sampling=SimpleNamespace(rate=RATE),
    )
    model = SimpleNamespace(slots=slots, members=members, size=len(NAMES) + len(slots))
    model.mask = partial(Model.mask, model)
    filtered = SimpleNamespace(trajectory=SimpleNamespace(velocity=velocity))
    return SimpleNamespace(logged=logged), SimpleNamespace(
        filtered=filtered, model=model, jacobian=jacobian.reshape(lanes * samples, -1)
    )


def moving(samples=2_000, rest=0):
    return np.r_[np.full(samples - rest, 0.05), np.zeros(rest)]


def test_a_log_that_ends_at_rest_is_judged_where_it_moves():
    fitter, best = of([moving(2_000, rest=1_000)], np.ones((1, 2_000, 1)), [(0, "force", None)])
    found = split(fitter, best)
    there = found.test[0, :1_000]
    assert 0.35 < np.mean(there) < 0.45
    assert (found.train + found.test == 1.0).all()


def test_what_begins_late_is_fitted_in_every_other_piece():
    tells = np.ones((1, 2_000, 1))
    tells[:, :1_500] = 0.0
    found = split(*of([moving()], tells, [(0, "force", None)]))
    assert "every other tenth of the log" in found.says
    assert 0.2 < np.mean(found.train[0, 1_500:]) < 0.8


def test_what_ends_early_is_judged_in_every_other_piece():
    """Where it does not act, nothing would be proved."""
    tells = np.zeros((1, 2_000, 1))
    tells[:, :800] = 1.0
    found = split(*of([moving()], tells, [(0, "more", None)]))
    assert "every other tenth of the log" in found.says
    assert 0.2 < np.mean(found.test[0, :800]) < 0.8


@pytest.mark.parametrize("tenth", [2, 5])
def test_what_acts_in_a_single_place_is_fitted_there(tenth):
    """A limit that one stroke reaches: held out, nothing but the prior would say where it is."""
    tells = np.zeros((1, 2_000, 1))
    tells[0, 200 * tenth + 50 : 200 * tenth + 100] = 1.0
    found = split(*of([moving()], tells, [(0, "limit", None)]))
    assert np.all(found.train[0, 200 * tenth + 50 : 200 * tenth + 100] == 1.0)
    assert (found.train + found.test == 1.0).all()
    assert 0.4 < np.mean(found.test) < 0.6


def test_rest_before_and_after_the_motion_is_never_judged():
    """Whichever of the tenths are held out."""
    velocity = np.r_[np.zeros(500), np.full(2_000, 0.05), np.zeros(500)]
    for tenth in (2, 5):
        tells = np.zeros((1, 3_000, 1))
        tells[0, 500 + 200 * tenth + 50 : 500 + 200 * tenth + 100] = 1.0
        found = split(*of([velocity], tells, [(0, "limit", None)]))
        assert np.all(found.train[0, :400] == 1.0)
        assert np.all(found.train[0, -400:] == 1.0)
        assert np.all(found.train[tells[..., 0] > 0.0] == 1.0)


@pytest.mark.parametrize("shows", [0, 1])
def test_an_effect_that_acts_in_one_log_alone_is_fitted_and_judged_there(shows):
    tells = np.zeros((2, 2_000, 1))
    tells[shows] = 1.0
    found = split(*of([moving(), moving()], tells, [(0, "more", None)]))
    assert found.whole == []
    assert 0.4 < np.mean(found.train[shows]) < 0.6
    assert 0.4 < np.mean(found.test[shows]) < 0.6


@pytest.mark.parametrize("knows", [0, 1])
def test_the_log_held_out_is_one_that_the_drives_own_numbers_need_not(knows):
    """A mass that one log alone tells is fitted there."""
    own = np.ones((2, 2_000, len(NAMES)))
    own[1 - knows, :, 0] = 0.0
    found = split(*of([moving(), moving()], np.ones((2, 2_000, 1)), [(0, "force", None)], own))
    assert found.whole == found.logs == [1 - knows]
    assert found.train[knows].all()
    assert not found.train[1 - knows].any()


def test_a_wave_that_ends_early_in_the_log_held_out_is_judged_on_all_of_it():
    tells = np.ones((2, 2_000, 3))
    tells[1, 800:] = 0.0
    slots = [(0, "frequency", None), (0, "cosine", 0), (0, "cosine", 1)]
    found = split(*of([moving(), moving()], tells, slots, members=(WAVE,)))
    assert found.whole == [1]
    assert found.test[1].all()
    assert found.register[1].all()


def test_sizes_of_the_session_are_registered_anew_and_need_not_be_told():
    tells = np.zeros((2, 2_000, 2))
    tells[0, :, 0] = tells[1, :, 1] = 1.0
    found = split(*of([moving(), moving()], tells, [(0, "cosine", 0), (0, "cosine", 1)], members=(WAVE,)))
    assert found.whole == [1]
    assert np.flatnonzero(found.register[1]).max() + 1 == np.flatnonzero(found.test[1]).min() == 1_000
    assert not (found.register * found.test).any()


def test_what_sets_in_late_in_the_log_held_out_is_registered_on_all_of_it():
    tells = np.zeros((2, 2_000, 2))
    tells[0, :, 0] = tells[1, 1_500:, 1] = 1.0
    found = split(*of([moving(), moving()], tells, [(0, "start", 0), (0, "start", 1)]))
    assert found.register[1].all()
    assert found.test[1].all()


@pytest.mark.parametrize("lengths", [(6_000, 200), (200, 6_000), (3_800, 200)])
def test_a_short_log_that_alone_tells_an_effect_is_fitted_as_much_as_judged(lengths):
    """Pieces are of each log: of all motion together, the short one would lie within one piece."""
    tells, short = np.zeros((2, max(lengths), 1)), int(np.argmin(lengths))
    tells[short, : lengths[short]] = 1.0
    fitter, best = of([moving(max(lengths))] * 2, tells, [(0, "mass", None)])
    for lane, length in enumerate(lengths):
        fitter.logged.lanes.counts[lane, length:] = 0.0
    found = split(fitter, best)
    assert 0.4 < found.train[short].sum() / lengths[short] < 0.6
    assert 0.4 < found.test[short].sum() / lengths[short] < 0.6


def test_of_many_logs_alike_one_is_held_out():
    found = split(*of([moving()] * 12, np.ones((12, 2_000, 1)), [(0, "force", None)]))
    assert found.whole == [11]


def test_a_log_at_rest_between_others_is_not_judged_by():
    tells = np.zeros((3, 2_000, 1))
    tells[0] = 1.0
    found = split(*of([moving(), 0.0 * moving(), moving()], tells, [(0, "force", None)]))
    assert found.logs == [0, 2]
    assert not found.test[1].any()


def test_nothing_is_judged_by_a_log_at_rest():
    found = split(*of([moving(), 0.0 * moving()], np.ones((2, 2_000, 1)), [(0, "force", None)]))
    assert found.logs == found.whole == [0]
    tells = np.stack([np.ones((2_000, 1)), np.zeros((2_000, 1))])
    found = split(*of([moving(), 0.0 * moving()], tells, [(0, "force", None)], nominal=tells))
    assert found.logs == [0]
    assert found.whole == []
    assert 0.4 < np.mean(found.test[0]) < 0.6


def test_where_each_log_alone_tells_something_pieces_of_all_are_held_out():
    tells = np.zeros((2, 2_000, 2))
    tells[0, :, 0] = tells[1, :, 1] = 1.0
    found = split(*of([moving(), moving()], tells, [(0, "force", None), (1, "stiffness", None)]))
    assert found.whole == []
    assert found.logs == [0, 1]
    assert all(0.4 < np.mean(found.train[log]) < 0.6 for log in (0, 1))
    assert (found.train + found.test == 1.0).all()
