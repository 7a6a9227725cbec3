"""What the names of columns say, in the habits of several makers of controls."""

import pytest

from diffdrive.logs.guess.names import Words, words_of

NAMES = {
    # Siemens, in German and of SINUMERIK's trace
    "Lagesollwert": ("position", "set", None),
    "Lageistwert 2. Messsystem": ("position", "actual", None),
    "Momentensollwert": ("force", "set", None),
    "Stromistwert iq": ("current", "actual", None),
    "Drehzahlistwert": ("velocity", "actual", None),
    "Schleppabstand": ("error", None, None),
    "cmdContrPos [u1, 1]": ("position", "set", None),
    "nckServoDataActPos1stEnc64 [u1, 1]": ("position", "actual", "motor"),
    "nckServoDataActPos2ndEnc64 [u1, 1]": ("position", "actual", "scale"),
    "nckServoDataCmdTorque64 [u1, 1]": ("force", "set", None),
    # HEIDENHAIN
    "s nominal X": ("position", "set", None),
    "v actual X": ("velocity", "actual", None),
    "I nominal X": ("current", "set", None),
    # TwinCAT, LinuxCNC
    "Axis 1.SetPos": ("position", "set", None),
    "Axis 1.ActTorque": ("force", "actual", None),
    "Axis 1.PosDiff": ("error", "set", None),
    "pid.x.output": ("force", None, None),
    # French, and the package's own
    "consigne position": ("position", "set", None),
    "mesure couple": ("force", "actual", None),
    "motor_position": ("position", None, "motor"),
    "command": ("force", "set", None),
    # words of two meanings
    "current position": ("position", None, None),
    "torque generating current": ("current", None, None),
    "Motorgeber": ("position", None, "motor"),
    "torque feedforward": ("force", "feedforward", None),
}


@pytest.mark.parametrize(("name", "says"), NAMES.items(), ids=NAMES.keys())
def test_a_name_says_quantity_role_and_encoder(name, says):
    found = words_of(name)
    assert (found.quantity, found.encoder) == (says[0], says[2])
    assert found.role == says[1] or found.quantity == "error"


@pytest.mark.parametrize("name", ["qg", "vir", "distance", "r0080", "Kanal 7", "history", "consistency"])
def test_a_name_that_is_not_made_of_known_words_says_nothing(name):
    assert words_of(name) == Words()
