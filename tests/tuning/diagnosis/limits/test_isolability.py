"""From which size on logs tell an effect from its closest rival: by hand, by least squares, and of a short stroke."""

from types import SimpleNamespace

import numpy as np
import pytest

from tests.support.perturbed_machine import catalogue, recalibrated_of
from tuning.diagnosis.levels import COLDEST, DECLARED, LACKING, LEFT
from tuning.diagnosis.limits import isolability
from tuning.diagnosis.limits.detection import (
    Answers,
    ByAmount,
    DetectionLimit,
    allowed,
    detection_limits,
    small_amounts,
)
from tuning.diagnosis.limits.isolability import Rivalry, _Columns, _isolable_size, _share
from tuning.diagnosis.limits.limit_words import rivalry_says

ROWS = 500


def of(columns):
    """Two effects of so many columns each, side by side."""
    first, second = (np.asarray(one) for one in columns)
    every = np.concatenate([first, second], axis=1)
    ends = first.shape[1], every.shape[1]
    return every.T @ every, _Columns(None, slice(0, ends[0])), _Columns(None, slice(*ends))


def ridge(columns, residual):
    """-2 log evidence of residuals with normal amounts, up to what all hypotheses share: -2 log N(r; 0, 1 + D D')."""
    covariance = np.eye(len(residual)) + columns @ columns.T
    return float(residual @ np.linalg.solve(covariance, residual) + np.linalg.slogdet(covariance)[1])


def leads(mine, other, amounts):
    """By how much the logs of a machine with these amounts speak for the first effect, over what excludes the second.

    As the verdict has it: a share of the evidence that was gained, or a number.
    """
    residual = mine @ amounts
    gained = float(residual @ residual) - ridge(mine, residual)
    lead = ridge(other, residual) - ridge(mine, residual)
    return lead - np.log(1.0 / DECLARED) * max(COLDEST, LEFT * gained)


@pytest.mark.parametrize("alike", [0.5, 0.9])
def test_an_effect_is_told_from_its_rival_from_the_size_on_at_which_that_is_excluded(alike):
    """Against the evidence of both, of a log that has the effect at that size and no noise."""
    rng = np.random.default_rng(3)
    mine, other = np.linalg.qr(rng.standard_normal((ROWS, 2)))[0].T
    mine, other = 40.0 * mine[:, None], 70.0 * (alike * mine + np.sqrt(1.0 - alike**2) * other)[:, None]
    products, first, second = of((mine, other))
    size = _isolable_size(products, first, second, [[0]])
    assert leads(mine, other, [size]) == pytest.approx(0.0, abs=1e-6)
    assert leads(mine, other, [0.99 * size]) < 0.0 < leads(mine, other, [1.01 * size])
    assert _share(products, first, second, [[0]]) == pytest.approx(alike**2)


def test_a_rival_that_does_nearly_all_of_it_is_never_excluded():
    """Since a model that is a little wrong in form loses a share of what it gains, however large that is."""
    rng = np.random.default_rng(3)
    mine, other = np.linalg.qr(rng.standard_normal((ROWS, 2)))[0].T
    mine, other = 40.0 * mine[:, None], 70.0 * (0.98 * mine + np.sqrt(1.0 - 0.98**2) * other)[:, None]
    products, first, second = of((mine, other))
    assert _isolable_size(products, first, second, [[0]]) == np.inf
    assert all(leads(mine, other, [size]) < 0.0 for size in np.geomspace(0.1, 1e4, 20))


def test_a_wave_is_told_apart_at_the_phase_that_is_most_alike():
    rng = np.random.default_rng(4)
    cosine, sine, apart = 50.0 * np.linalg.qr(rng.standard_normal((ROWS, 3)))[0].T
    wave, other = np.stack([cosine, sine], axis=1), (0.8 * cosine + 0.6 * apart)[:, None]
    products, first, second = of((wave, other))
    size = _isolable_size(products, first, second, [[0, 1]])
    phases = np.linspace(0.0, np.pi, 181)
    found = [leads(wave, other, size * np.array([np.cos(one), np.sin(one)])) for one in phases]
    assert min(found) == pytest.approx(0.0, abs=1e-6)
    assert int(np.argmin(found)) in (0, 180)
    assert _share(products, first, second, [[0, 1]]) == pytest.approx(0.5 * 0.64)


def test_two_that_do_the_same_are_never_told_apart(monkeypatch):
    """Both are named, each with the other, and the one that is not seen is not."""
    rng = np.random.default_rng(5)
    column = rng.standard_normal((ROWS, 1))
    parameter = SimpleNamespace(name="force", spread=2.0)
    amounts = [
        ByAmount(
            SimpleNamespace(name=name, least=0.0, parameters=(parameter,), by_name={"force": parameter}), {},
            [Answers([(parameter, None)], scale * column, np.zeros((0, 1)))],
        )
        for name, scale in (("tilt", 10.0), ("counterbalance", 10.0), ("unseen", 1e-3))
    ]  # fmt: skip
    monkeypatch.setattr(
        isolability, "limit_of",
        lambda _, candidate, name, size: DetectionLimit(candidate.name, name, "N", size, False),
    )  # fmt: skip
    empty = np.zeros((ROWS, 0))
    fitted = SimpleNamespace(hessian=np.zeros((0, 0)), jacobian=empty, residual=np.zeros(ROWS), theta=np.zeros(0))
    limits = [DetectionLimit(one.candidate.name, "force", "N", 0.3, False) for one in amounts[:2]]
    found = isolability.rivalries(None, fitted, amounts, limits)
    assert [(one.seen.effect, one.rival, one.isolable) for one in found] == [
        ("tilt", "counterbalance", None), ("counterbalance", "tilt", None),
    ]  # fmt: skip
    assert [one.share for one in found] == pytest.approx([1.0, 1.0])


@pytest.mark.long
def test_logs_of_a_motion_that_tells_everything_leave_no_rivals():
    fitter, base = recalibrated_of()
    base = allowed(fitter, base)
    amounts = small_amounts(fitter, base, catalogue(fitter, base))
    assert {one.candidate.name for one in amounts} > {"constant_force", "cogging", "force_gain"}
    limits = detection_limits(fitter, base, catalogue(fitter, base), amounts, LACKING)
    for one in isolability.rivalries(fitter, base, amounts, limits):
        assert one.isolable is None or one.isolable > one.seen.size


def test_a_rivalry_in_words():
    seen = DetectionLimit("cogging", "amplitude", "N", 0.23, False)
    assert rivalry_says(Rivalry(seen, "lead_error", 0.934, 3.4)) == (
        "cogging, amplitude from 0.23 N to 3.4 N: lead_error, which does 93 % of the same on average over the phases, "
        "is not excluded at the hardest phase"
    )
    assert "from 0.23 N on: lead_error" in rivalry_says(Rivalry(seen, "lead_error", 1.0, None))


@pytest.mark.parametrize(
    ("effect", "parameter", "unit", "low", "high", "says"),
    [
        ("friction_shape", "viscous", "N*s/m", 236.808, 244.880, "viscous from 237 N s/m to 245 N s/m: "),
        ("friction_shape", "breakaway_gap", "1", 0.121080, 0.123171, "breakaway_gap from 12.9 % to 13.1 %: "),
        ("backlash", "gap", "m", 4.00001e-7, 4.00002e-7, "gap from 0.400001 um to 0.400002 um: "),
        ("applied_load", "load", "N", 1234567.1, 1234568.2, "load from 1234567 N to 1234568 N: "),
        ("applied_load", "load", "N", 14854.0, 18456.0, "load from 15000 N to 18000 N: "),
        ("applied_load", "load", "N", 5.0, 5.0 * (1.0 + 1e-15), "load of 5 N: "),
    ],
)
def test_the_ends_of_a_range_have_the_digits_that_tell_them_apart(effect, parameter, unit, low, high, says):
    seen = DetectionLimit(effect, parameter, unit, low, False)
    told = rivalry_says(Rivalry(seen, "force_gain", 0.24, high))
    assert told == f"{effect}, {says}force_gain, which does 24 % of the same, is not excluded"
