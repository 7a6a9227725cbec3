"""What a ladder fits to and what it is judged by: motion on both sides, and every number told by what is fitted."""

from types import SimpleNamespace

import numpy as np

from tuning.diagnosis.calibration import NAMES
from tuning.diagnosis.splitting import split

RATE = 1_000.0


def of(velocity, tells, slots):
    """A fit to lanes that move at these velocities (m/s), one log each; `tells` [lanes, n, slots] of the jacobian."""
    velocity, tells = np.asarray(velocity, float), np.asarray(tells, float)
    lanes, samples = velocity.shape
    jacobian = np.concatenate([np.ones((lanes, samples, len(NAMES))), tells], axis=2)
    logged = SimpleNamespace(
        lanes=SimpleNamespace(counts=np.ones((lanes, samples))),
        owner=tuple(range(lanes)),
        logs=lanes,
        sampling=SimpleNamespace(rate=RATE),
    )
    model = SimpleNamespace(slots=slots, members=())
    track = SimpleNamespace(course=SimpleNamespace(velocity=velocity))
    return SimpleNamespace(logged=logged), SimpleNamespace(
        track=track, model=model, jacobian=jacobian.reshape(lanes * samples, -1)
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


def test_the_log_held_out_is_one_that_the_others_need_not():
    """An effect that acts in one log alone: whichever it is, it is fitted there."""
    for shows in (0, 1):
        tells = np.zeros((2, 2_000, 1))
        tells[shows] = 1.0
        found = split(*of([moving(), moving()], tells, [(0, "more", None)]))
        assert found.whole == found.logs == [1 - shows]
        assert found.train[shows].all()
        assert not found.train[1 - shows].any()


def test_sizes_of_the_session_are_registered_anew_and_need_not_be_told():
    tells = np.zeros((2, 2_000, 2))
    tells[0, :, 0] = tells[1, :, 1] = 1.0
    found = split(*of([moving(), moving()], tells, [(0, "cosine", 0), (0, "cosine", 1)]))
    assert found.whole == [1]
    assert np.flatnonzero(found.register[1]).max() + 1 == np.flatnonzero(found.test[1]).min() == 1_000
    assert not (found.register * found.test).any()


def test_what_sets_in_late_in_the_log_held_out_is_registered_on_all_of_it():
    tells = np.zeros((2, 2_000, 2))
    tells[0, :, 0] = tells[1, 1_500:, 1] = 1.0
    found = split(*of([moving(), moving()], tells, [(0, "start", 0), (0, "start", 1)]))
    assert found.register[1].all()
    assert found.test[1].all()


def test_a_log_at_rest_is_not_held_out():
    found = split(*of([moving(), 0.0 * moving()], np.ones((2, 2_000, 1)), [(0, "force", None)]))
    assert found.whole == [0]


def test_where_each_log_alone_tells_something_pieces_of_all_are_held_out():
    tells = np.zeros((2, 2_000, 2))
    tells[0, :, 0] = tells[1, :, 1] = 1.0
    found = split(*of([moving(), moving()], tells, [(0, "force", None), (1, "stiffness", None)]))
    assert found.whole == []
    assert found.logs == [0, 1]
    assert all(0.4 < np.mean(found.train[log]) < 0.6 for log in (0, 1))
    assert (found.train + found.test == 1.0).all()
