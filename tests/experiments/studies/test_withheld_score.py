"""The scorecard of the withheld-effect check: classes, failed answers, parameters, the oracle, calibration."""

import pytest

from experiments.studies.withheld import reruns
from experiments.studies.withheld.score import is_clear, score
from experiments.studies.withheld.study import SHOWN

ERROR = {"verdict": "error", "says": "ValueError: x", "causes": []}


def cause(name, found=True, confidence=0.9, evidence=10.0, others=(), **parameters):
    return {
        "effect": name, "found": found, "confidence": confidence, "evidence": evidence,
        "indistinguishable_from": list(others), "parameters": parameters, "intervals": {},
    }  # fmt: skip


def diagnosis(verdict, *causes, gap=5.0, after=1.0):
    ladder = [{"force_rms_N": one} for one in (9.0, 5.0, after)]
    return {
        "verdict": verdict, "causes": list(causes), "ladder": ladder,
        "gap": {"recalibrated_force_rms_N": gap, "noise_floor_force_N": 1.0},
    }  # fmt: skip


def truth(*names, size=2.0, outside=False, true=None, **more):
    effects = [{"name": name, "size": size, "outside": outside, "true": true or {}} for name in names]
    return {"effects": effects, **more}


def score_of(*pairs, oracle=None):
    answers = {str(k): answer for k, (answer, _) in enumerate(pairs)}
    return score(answers, {str(k): key for k, (_, key) in enumerate(pairs)}, oracle)


def test_a_failed_answer_is_wrong_in_the_class_of_its_key():
    card = score_of(
        (ERROR, truth("cogging", size=2.0)),
        (ERROR, truth("cogging", size=0.5)),
        (ERROR, truth()),
        (ERROR, truth("chip", outside=True)),
        (ERROR, truth("cogging", "backlash")),
    )
    assert (card["errors"], card["clear_single"], card["faint_single"]) == (5, 1, 1)
    for name in ("named_clear", "top1_clear", "declared_clear", "top2_clear", "exact_clear", "named_faint",
                 "top1_faint", "top2_faint", "unknown_recall", "both_found"):  # fmt: skip
        assert card[name] == 0.0
    assert card["false_alarms"] == card["confidently_wrong"] == card["confidently_wrong_faint"] == 1.0
    assert card["confusion"]["cogging"] == {"error": 2}
    assert card["rows"][0]["visibility"] is None


@pytest.mark.parametrize(("base", "last", "shrink"), [(5.0, None, 0.0), (None, 1.0, None), (5.0, 1.0, 1.0)])
def test_a_filter_that_ran_away_on_what_was_held_out_closes_nothing(base, last, shrink):
    answer = diagnosis("effect", cause("cogging"))
    answer["ladder"] = [{"force_rms_N": one} for one in (9.0, base, last)]
    assert score_of((answer, truth("cogging")))["median_shrink_held_out"] == shrink


def test_what_was_found_does_not_make_a_case_faint():
    """A wrong cause that shakes the loop has a large floor of its own, or none at all."""
    answer = diagnosis("effect", cause("actuator_lag"), gap=1.0)
    answer["gap"] |= {"recalibrated_position_rms_m": 1e-6, "noise_floor_position_m": 9e-7}
    answer["ladder"][1] |= {"position_floor_m": 1e-7, "force_floor_N": 1.0, "loop_says": ""}
    assert score_of((answer, truth("loop_delay")))["rows"][0]["visibility"] == pytest.approx(10.0)
    answer["gap"]["recalibrated_position_rms_m"] = None
    answer["ladder"][1] |= {"position_floor_m": None, "loop_says": "a: the simulation in closed loop runs away"}
    assert score_of((answer, truth("loop_delay")))["clear_single"] == 1


def test_a_case_that_declares_the_whole_catalogue_is_told_apart():
    few, many = ["cogging", "backlash"], ["cogging", "backlash", "compliance"]
    card = score_of(
        (diagnosis("effect", cause("lead_error", others=few)), truth("cogging")),
        (diagnosis("effect", cause("lead_error", others=many)), truth("cogging")),
    )
    assert (card["declared_clear"], card["declared_clear_of_few"]) == (1.0, 0.5)
    assert (card["declared_at_once"], card["most_declared"]) == (2.5, 3)


def test_an_answer_whose_force_cannot_be_told_closes_nothing():
    answer = diagnosis("effect", cause("cogging"))
    answer["gap"]["noise_floor_force_N"] = None
    answer["ladder"] = [{"force_rms_N": one} for one in (9.0, 5.0, None)]
    assert score_of((answer, truth("cogging")))["median_shrink_held_out"] == 0.0
    answer["ladder"][1]["force_rms_N"] = None
    assert score_of((answer, truth("cogging")))["median_shrink_held_out"] is None


def test_a_case_without_an_answer_is_one_that_failed():
    card = score({}, {"1": truth("cogging", size=2.0), "2": truth()})
    assert (card["cases"], card["errors"], card["named_clear"], card["said_none"]) == (2, 2, 0.0, 0.0)
    assert card["median_shrink_held_out"] == 0.0


def test_what_is_said_beside_the_truth_counts_in_the_exact_rates():
    both = [cause("cogging"), cause("backlash")]
    card = score_of(
        (diagnosis("effect", *both), truth("cogging")),
        (diagnosis("effect", *both), truth("cogging", "backlash")),
        (diagnosis("unknown", *both), truth("cogging", "backlash")),
        (diagnosis("unknown"), truth()),
        (diagnosis("none"), truth()),
    )
    assert (card["named_clear"], card["exact_clear"]) == (1.0, 0.0)
    assert (card["both_found"], card["both_named"]) == (1.0, 0.5)
    assert (card["false_alarms"], card["said_none"]) == (0.0, 0.5)


def test_what_recalibration_swallowed_counts_by_the_size_that_was_drawn():
    swallowed = diagnosis("none", gap=1.0)
    card = score_of(
        (swallowed, truth("cogging", size=2.0)),
        (swallowed, truth("compliance", size=2.0, pitfall=True)),
        (diagnosis("effect", cause("cogging")), truth("cogging", size=1.0)),
        (swallowed, truth("cogging", size=0.9)),
    )
    assert (card["clear_single"], card["named_clear"]) == (1, 1.0)
    assert (card["drawn_clear"], card["named_drawn_clear"]) == (3, pytest.approx(1 / 3, abs=1e-3))


def test_shares_have_intervals():
    """Wilson's for 9 of 10, from his formula."""
    right, wrong = diagnosis("effect", cause("cogging")), diagnosis("effect", cause("backlash"))
    card = score_of(*[(right, truth("cogging"))] * 9, (wrong, truth("cogging")))
    n, p, z = 10, 0.9, 1.959964
    half = z * (p * (1 - p) / n + z**2 / (4 * n**2)) ** 0.5
    expected = [(p + z**2 / (2 * n) + way * half) / (1 + z**2 / n) for way in (-1, 1)]
    assert card["intervals"]["named_clear"] == pytest.approx(expected, abs=1e-3)
    assert card["intervals"]["both_found"] is None


def test_clear_is_the_keys_word_then_the_gap_then_the_size():
    assert is_clear(diagnosis("none", gap=1.1), truth("cogging", visibility="clear"))
    assert not is_clear(diagnosis("none", gap=50.0), truth("cogging", visibility="faint"))
    assert is_clear(diagnosis("none", gap=3.1), truth("cogging", size=0.3))
    assert not is_clear(diagnosis("none", gap=2.9), truth("cogging", size=4.0))
    assert is_clear(ERROR, truth("cogging", size=1.2))
    assert not is_clear(ERROR, truth("cogging", size=0.8))


def test_named_is_found_first_with_the_verdict_that_there_is_an_effect():
    card = score_of(
        (diagnosis("effect", cause("cogging")), truth("cogging")),
        (diagnosis("unknown", cause("cogging")), truth("cogging")),
        (diagnosis("unknown", cause("cogging"), gap=2.0), truth("cogging")),
        (diagnosis("effect", cause("backlash"), cause("cogging", found=False), gap=2.0), truth("cogging")),
    )
    assert (card["named_clear"], card["top1_clear"], card["exact_clear"]) == (0.5, 1.0, 0.5)
    assert (card["named_faint"], card["top1_faint"], card["top2_faint"]) == (0.0, 0.5, 1.0)


def test_pitfalls_are_counted_apart():
    card = score_of(
        (diagnosis("effect", cause("compliance")), truth("compliance", pitfall=True)),
        (diagnosis("none"), truth("compliance", pitfall=True)),
        (diagnosis("effect", cause("compliance")), truth("compliance")),
    )
    assert (card["pitfalls"], card["pitfall_named"], card["clear_single"]) == (2, 0.5, 1)


def test_everything_that_is_shown_is_there():
    assert set(SHOWN) <= set(score_of())
    assert {"named_clear", "exact_clear", "top2_faint", "errors", "pitfall_named"} <= set(SHOWN)


@pytest.mark.parametrize(
    ("found", "true", "error"),
    [
        ({"mass": 11.0}, {"mass": 10.0}, 0.1),
        ({"cosine": 3.0, "sine": 4.0, "period": 1e-3}, {"amplitude": 4.0, "period": 1e-3}, 0.25),
        ({"cosine": [3.0, 4.0], "sine": [4.0, 0.0]}, {"amplitude": 5.0}, 0.2),
        ({"start": [1.1, 2.0], "end": [4.0, 5.0]}, {"start": [1.0, 2.0], "end": [4.0, 10.0]}, 0.5),
        ({"mean": [0.1, 0.2], "frequency": 55.0}, {"mean": 0.0, "frequency": 50.0}, 0.1),
        ({"gain": 0.1}, {"gain": 0.0}, None),
        ({"gain": 0.1}, {}, None),
    ],
)
def test_parameters_are_compared_one_by_one(found, true, error):
    card = score_of((diagnosis("effect", cause("cogging", **found)), truth("cogging", true=true)))
    assert card["median_parameter_error"] == (None if error is None else pytest.approx(error))


def test_intervals_are_held_against_the_truth_where_one_effect_was_found_alone():
    right = cause("cogging", period=1e-3, mean=[1.0, 2.0])
    right["intervals"] = {"period": [0.9e-3, 1.1e-3], "mean": [[0.5, 1.5], [1.5, 2.5]]}
    true = truth("cogging", true={"period": 1.05e-3, "mean": [1.2, 3.0]})
    card = score_of((diagnosis("effect", right), true), (diagnosis("effect", right, cause("backlash")), true))
    assert (card["interval_coverage"], card["intervals_told"]) == (0.667, 3)
    right["intervals"]["period"] = [None, 1.1e-3]
    assert score_of((diagnosis("effect", right), true))["interval_coverage"] == 0.333
    assert score_of((diagnosis("none"), truth()))["interval_coverage"] is None


def test_without_an_oracle_nothing_is_said_of_one():
    right, wrong = diagnosis("effect", cause("cogging"), after=2.0), diagnosis("effect", cause("backlash"), after=3.0)
    pairs = [(right, truth("cogging")), (wrong, truth("cogging"))]
    assert score_of(*pairs)["median_shrink_of_oracle"] is None
    # 1 - 3 / 24 with the right one, which needs no oracle; 1 - 8 / 24 against the oracle's 1
    card = score_of(*pairs, oracle={"1": diagnosis("effect", cause("cogging"), after=1.0)})
    assert card["median_shrink_of_oracle"] == pytest.approx(0.5 * (1.0 + 16 / 24), abs=1e-4)
    assert score_of(pairs[1], oracle={})["median_shrink_of_oracle"] is None
    assert score_of(pairs[1], oracle={"0": ERROR})["median_shrink_of_oracle"] is None
    assert score_of(pairs[0], oracle={})["median_shrink_of_oracle"] == 1.0
    # where the truth itself closes nothing, a wrong answer is as good or has opened the gap further
    nothing = diagnosis("effect", cause("cogging"), after=5.0)
    for after, share in ((5.0, None), (8.0, 0.0)):
        card = score_of((diagnosis("effect", cause("backlash"), after=after), truth("cogging")), oracle={"0": nothing})
        assert card["median_shrink_of_oracle"] == share
    # an answer that failed closes nothing of what could have been closed, known or not
    for oracle in ({"1": ERROR}, {}):
        card = score_of(pairs[0], (ERROR, truth("cogging")), oracle=oracle)
        assert (card["median_shrink_of_oracle"], card["shrinks_of_oracle"]) == (0.5, 2)


def test_confidences_are_held_against_how_often_they_are_right():
    card = score_of(
        *[(diagnosis("effect", cause("cogging", confidence=0.75)), truth("cogging" if k < 3 else "backlash"))
          for k in range(4)],
        *[(diagnosis("effect", cause("cogging", confidence=1.0)), truth("cogging" if k < 2 else "backlash"))
          for k in range(4)],
    )  # fmt: skip
    assert card["calibration_error"] == pytest.approx(0.5 * 0.0 + 0.5 * 0.5)
    assert card["reliability"] == [[0.75, 4, 0.75], [1.0, 4, 0.5]]
    assert score_of((diagnosis("none"), truth()))["calibration_error"] is None


def test_the_confusion_counts_what_was_said_of_effects_that_were_alone():
    card = score_of(
        (diagnosis("effect", cause("backlash")), truth("cogging")),
        (diagnosis("unknown", cause("cogging")), truth("cogging")),
        (diagnosis("effect", cause("cogging")), truth()),
        (diagnosis("none"), truth("chip", outside=True)),
        (diagnosis("effect", cause("cogging")), truth("cogging", "backlash")),
    )
    assert card["confusion"] == {"chip": {"none": 1}, "cogging": {"backlash": 1, "unknown": 1}, "none": {"cogging": 1}}


def test_the_oracle_is_asked_where_the_known_effects_were_not_just_what_was_found():
    answers = {
        "right": diagnosis("effect", cause("cogging")),
        "more": diagnosis("effect", cause("cogging"), cause("backlash")),
        "unsure": diagnosis("unknown", cause("cogging", found=False)),
        "failed": ERROR,
        "outside": diagnosis("unknown"),
        "sound": diagnosis("effect", cause("cogging")),
    }
    key = {name: truth("cogging") for name in answers}
    key |= {"outside": truth("chip", outside=True), "sound": truth()}
    exclusions = reruns.oracle_exclusions(answers, key)
    assert sorted(exclusions) == ["failed", "more", "unsure"]
    assert "cogging" not in exclusions["more"]
    assert len(exclusions["more"]) == 20


def test_an_effect_is_removed_where_it_was_seen_best():
    answers = {
        "1": diagnosis("effect", cause("cogging", evidence=5.0)),
        "2": diagnosis("effect", cause("cogging", evidence=50.0)),
        "3": diagnosis("effect", cause("cogging", evidence=500.0)),  # not alone
        "4": diagnosis("effect", cause("cogging", evidence=90.0)),  # not true
        "5": diagnosis("unknown", cause("compliance", found=False)),
        "6": ERROR,
        "7": diagnosis("unknown", cause("cogging", evidence=900.0)),  # not believed
        "8": diagnosis("effect", cause("cogging", evidence=900.0), cause("backlash")),  # not alone either
    }
    key = {name: truth("cogging") for name in [*answers, "never asked"]}
    answers["of another check"] = diagnosis("effect", cause("cogging", evidence=900.0))
    key |= {"3": truth("cogging", "backlash"), "4": truth("backlash"), "5": truth("compliance")}
    assert reruns.removal_exclusions(answers, key) == {"2": ["cogging"]}


@pytest.mark.parametrize(
    ("rerun", "good"),
    [
        (diagnosis("unknown"), True),
        (diagnosis("effect", cause("lead_error")), True),
        (diagnosis("effect", cause("backlash")), False),
        (diagnosis("effect", cause("lead_error"), cause("backlash")), False),
        (diagnosis("none"), False),
        (ERROR, False),
    ],
)
def test_without_the_true_effect_the_answer_is_unknown_or_a_declared_rival(rerun, good):
    answers = {"1": diagnosis("effect", cause("cogging", others=["lead_error"]))}
    (row,) = reruns.removal_rows(answers, {"1": rerun}, {"1": ["cogging"], "2": ["backlash"]})
    assert row[:3] == ["cogging", "1", rerun["verdict"]]
    assert row[-1] is good
