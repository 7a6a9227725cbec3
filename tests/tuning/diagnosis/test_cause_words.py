"""What was found, in words: numbers with intervals and units, waves, factors, and a headline."""

import numpy as np

from tuning.diagnosis.cause_words import headlines, numbers, parameter


def test_a_parameter_that_differs_from_log_to_log_is_told_for_each():
    cause = {
        "parameters": {"sine": [1.0, -2.0], "period": 0.005, "rested": [0.3]},
        "intervals": {"sine": ([0.9, -2.1], [1.1, -1.9]), "period": (0.004, 0.006), "rested": ([0.2], [0.4])},
        "units": {"sine": "N", "period": "m", "rested": "s"},
        "effect": "cogging",
    }
    assert parameter("sine", cause) == "sine log 1: 1.00 (0.90 to 1.10) N, log 2: -2.00 (-2.10 to -1.90) N"
    assert parameter("period", cause) == "period 5.0 (4.0 to 6.0) mm"
    assert parameter("rested", cause) == "rested 0.30 (0.20 to 0.40) s"
    cause["intervals"]["period"] = (None, 0.006)
    assert parameter("period", cause) == "period 5 (- to 6) mm"


def test_a_wave_is_told_by_its_amplitude_and_phase_and_what_is_none_not_at_all():
    """3 cos x - 4 sin x = 5 cos(x + 53.13 deg); a second harmonic that its intervals do not tell from none."""
    cause = {
        "effect": "cogging",
        "parameters": {"cosine": [3.0, 5.0], "sine": [-4.0, 0.0], "cosine2": 0.01, "sine2": -0.02, "period": 0.005},
        "intervals": {
            "cosine": ([2.7, 4.7], [3.3, 5.3]), "sine": ([-4.3, -0.3], [-3.7, 0.3]),
            "cosine2": (-0.1, 0.12), "sine2": (-0.13, 0.09), "period": (0.0049, 0.0051),
        },
        "units": dict.fromkeys(("cosine", "sine", "cosine2", "sine2"), "N") | {"period": "m"},
    }  # fmt: skip
    first = "amplitude log 1: 5.00 (4.70 to 5.30) N, log 2: 5.00 (4.70 to 5.30) N, phase -53, 0 deg"
    assert numbers(cause) == [first, "period 5.00 (4.90 to 5.10) mm"]
    found = cause | {"confidence": 0.97, "found": True}
    line = f"cogging, 97 % sure: {first}; period 5.00 (4.90 to 5.10) mm"
    assert headlines([found, found | {"found": False}]) == [line]


def test_a_headline_shows_the_numbers_that_are_furthest_from_none():
    """A share has no unit; of waves none of which is told from none the largest is shown all the same."""
    cause = {
        "effect": "position_friction", "confidence": 0.97, "found": True,
        "parameters": {"slope": 0.01, "period": 0.1, "cosine": 0.03, "sine": 0.04},
        "intervals": {"slope": (-0.1, 0.12), "period": (0.099, 0.101), "cosine": (0.029, 0.031),
                      "sine": (0.039, 0.041)},
        "units": {"slope": "1/m", "period": "m", "cosine": "1", "sine": "1"},
    }  # fmt: skip
    shown = "amplitude 0.0500 (0.0490 to 0.0510), phase 53 deg; period 100.0 (99.0 to 101.0) mm"
    assert headlines([cause]) == [f"position_friction, 97 % sure: {shown}"]
    cause["intervals"] |= {"cosine": (-0.1, 0.2), "sine": (-0.2, 0.2)}
    assert headlines([cause])[0].startswith("position_friction, 97 % sure: amplitude 0.05 (0.00 to ")
    cause["intervals"] |= {"cosine": (None, None)}
    assert numbers(cause)[0] == "amplitude 0.05 (- to -), phase 53 deg"


def test_what_a_friction_shape_holds_as_logarithms_is_told_as_factors():
    cause = {
        "effect": "friction_shape",
        "parameters": {"stribeck_exponent": np.log(2.0), "coulomb": 0.5},
        "intervals": {"stribeck_exponent": (np.log(1.9), np.log(2.1)), "coulomb": (0.4, 0.6)},
        "units": {"stribeck_exponent": "1", "coulomb": "N"},
    }
    assert numbers(cause) == [
        "stribeck_exponent 2.00 (1.90 to 2.10) times the recalibrated",
        "coulomb 0.50 (0.40 to 0.60) N",
    ]
