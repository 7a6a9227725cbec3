"""Bad drive files: each mistake is refused in one line that names the table, the key and the mend."""

import copy

import pytest
import tomli_w

from diffdrive.axis import Axis
from diffdrive.axis_file.drive_file import axis_tables, parse_axis, read_axis
from diffdrive.controllers import PD
from diffdrive.controllers.base import paper_tracking
from diffdrive.errors import DriveFileError
from diffdrive.model.parameters import Sampling
from diffdrive.model.presets import PAPER_KD, PAPER_KP, paper_drive
from diffdrive.motion.motion import Limits

PAPER_PD = PD(paper_tracking(paper_drive(quantised=False), PAPER_KP, PAPER_KD))
NAN, INF = float("nan"), float("inf")
TABLES = axis_tables(Axis(paper_drive(), PAPER_PD, Sampling(), Limits((-0.075, 0.075))))
MISSING = object()

FILES = {
    "unknown key": ("plant.mas", 100.0, r"\[plant\] mas: unknown key; did you mean 'mass'\?"),
    "unknown key, nothing near": ("sensor.xyz", 1.0, r"\[sensor\] xyz: unknown key; known here: noise, resolution"),
    "unknown table": ("plants", {}, r"plants: unknown key; did you mean 'plant'\?"),
    "number for a table": ("sensor", 1e-7, r"\[sensor\] must be a table"),
    "missing key": ("plant.mass", MISSING, r"\[plant\] mass: is missing: give the moving mass.* in kg"),
    "typo in a key that must be": (
        "plant",
        {"mas": 100.0},
        r"\[plant\] mass: is missing: .* in kg; is it meant by 'mas'\?",
    ),
    "missing table": ("friction", MISSING, r"\[friction\] coulomb_screw: is missing: .* in N"),
    "missing gains": ("controller.kd", MISSING, r"\[controller\] kd: is missing: .* in N\*s/m"),
    "wrong unit": ("plant.mass", "100 mm", r"\[plant\] mass: '100 mm' has the wrong unit: it must be in kg"),
    "unparsable unit": (
        "plant.mass",
        "100 zorks",
        r"\[plant\] mass: cannot read '100 zorks'.* write for example '1.5 kg'",
    ),
    "word for a number": ("sensor.noise", "quiet", r"\[sensor\] noise: cannot read 'quiet'.* for example '1.5 m'"),
    "bool for a number": ("plant.mass", True, r"\[plant\] mass: must be a number in kg"),
    "table for a number": ("plant.mass", {}, r"\[plant\] mass: must be a number in kg"),
    "three directions": (
        "plant.damping",
        [1.0, 2.0, 3.0],
        r"\[plant\] damping: needs two values, \[positive, negative\]",
    ),
    "bool in a direction": ("plant.damping", [1.0, False], r"\[plant\] damping: must be a number in N\*s/m"),
    "list for a scalar": ("plant.mass", [100.0, 100.0], r"\[plant\] mass: must be one number in kg"),
    "NaN": ("plant.mass", NAN, r"plant\.mass must be finite"),
    "infinite": ("friction.viscous", INF, r"friction\.viscous .*must be finite"),
    "negative": ("plant.mass", -1, r"plant\.mass must be above 0 kg"),
    "zero resolution": ("sensor.resolution", 0.0, r"sensor\.resolution must be above 0 m"),
    "micrometres": ("sensor.resolution", 0.1, r"\[sensor\] resolution: 0\.1 m is coarser .* is it in micrometres\?"),
    "no Coulomb friction, and less at rest": (
        "friction",
        {"coulomb_screw": 0, "load_coefficient": 0, "breakaway_gap": -1.0},
        r"breakaway friction in the positive direction is -1 N: .* beside a Coulomb friction of 0 \(coulomb_screw",
    ),
    "two screws": (
        "effects",
        {"compliance": {"frequency": 200}, "backlash": {"gap": "5 um", "frequency": 400}},
        r"effects\.backlash: a machine has one screw, and effects\.compliance is one, too: keep either",
    ),
    "negative delay": ("actuator.delay_samples", -1, r"\[actuator\] delay_samples: must be a whole number of samples"),
    "fractional delay": ("actuator.delay_samples", 0.5, r"\[actuator\] delay_samples: must be a whole number"),
    "bool delay": ("actuator.delay_samples", True, r"\[actuator\] delay_samples: must be a whole number"),
    "rate 0": ("sampling.rate", 0, r"sampling\.rate must lie between 10 and 1e6 Hz"),
    "rate as a period": (
        "sampling.rate",
        "0.1 ms",
        r"\[sampling\] rate: '0.1 ms' has the wrong unit: it must be in Hz",
    ),
    "substeps 0": ("sampling.substeps", 0, r"sampling\.substeps must be a whole number of at least 1"),
    "bool substeps": ("sampling.substeps", True, r"sampling\.substeps must be a whole number of at least 1"),
    "substeps as text": ("sampling.substeps", "4", r"sampling\.substeps must be a whole number of at least 1"),
    "stroke reversed": (
        "limits.stroke",
        [0.1, -0.1],
        r"\[limits\] stroke: the lowest position must be below the highest",
    ),
    "stroke of three": ("limits.stroke", [0.0, 0.1, 0.2], r"\[limits\] stroke: must be \[lowest, highest\]"),
    "one end of the stroke with a unit": (
        "limits.stroke",
        ["-75 mm", 75],
        r"\[limits\] stroke: give both ends a unit, or neither where they are in m, got \['-75 mm', 75\]$",
    ),
    "megametres": ("limits.speed", "5 Mm/s", r"\[limits\] speed: '5 Mm/s' says Mm, which is 1000 km; write mm"),
    "400 digits": ("plant.mass", 10**400, r"\[plant\] mass: 1000000.*0000 is larger than any number of double"),
    "400 digits with a unit": (
        "plant.mass",
        "9" * 400 + " kg",
        r"\[plant\] mass: '999.* kg' is larger than any number",
    ),
    "an exponent of 400": ("limits.speed", "1e400 m/s", r"\[limits\] speed: '1e400 m/s' is larger than any number"),
    "a list of a thousand lists": ("plant.mass", [[[1]] * 1000] * 1000, r"\[plant\] mass: must be one number .{,150}$"),
    "a share of nothing": (
        "friction.stribeck_exponent",
        4.5,
        r"friction\.stribeck_exponent must be at most 4, got 4\.5$",
    ),
    "a share as text": ("friction.load_coefficient", [], r"load_coefficient: needs two values"),
    "a share as bool": ("friction.load_coefficient", True, r"load_coefficient: must be a number, got True$"),
    "a key that colours the terminal": ("plant.\x1b[31mmass", 1.0, r"\[plant\] \\x1b\[31mmass: unknown key"),
    "substeps beyond rounding": (
        "sampling.substeps",
        10**12,
        r"sampling\.substeps must be at most 3356 at 10000 Hz, got 1000000000000: finer substeps gain nothing",
    ),
    "stroke in kg": ("limits.stroke", [0.0, "3 kg"], r"\[limits\] stroke: '3 kg' has the wrong unit: it must be in m"),
    "speed 0": ("limits.speed", 0.0, r"\[limits\] speed: must be positive"),
    "NaN acceleration": ("limits.acceleration", NAN, r"\[limits\] acceleration: must be positive"),
    "a current loop slower than any": (
        "actuator.current_loop_frequency",
        1e-300,
        r"actuator\.current_loop_frequency must be at least 1 Hz",
    ),
    "a current loop faster than any": (
        "actuator.current_loop_frequency",
        "10 MHz",
        r"actuator\.current_loop_frequency must be at most 1e\+06 Hz",
    ),
    "a damping of no current loop": (
        "actuator.current_loop_damping",
        0.7,
        r"give current_loop_frequency, too, or neither",
    ),
    "unknown controller": (
        "controller.kind",
        "pid",
        r"\[controller\] kind: unknown controller 'pid'; known: pd, dobvsc",
    ),
    "list of controllers": ("controller.kind", ["pd"], r"\[controller\] kind: unknown controller"),
    "no controller": ("controller", MISSING, r"\[controller\] kind: is missing; known: pd, dobvsc"),
    "feedforward as text": ("controller.feedforward", "yes", r"\[controller\] feedforward: must be true or false"),
    "other derivative": ("controller.derivative", "filtered", r"\[controller\] derivative: only 'backward-difference'"),
    "negative gain": ("controller.kp", -1.0, r"controller\.kp must be at least 0 N/m"),
    "gain of another controller": (
        "controller.cutoff",
        240.0,
        r"\[controller\] cutoff: belongs to kind dobvsc, pd\+ff\+dob; for kind pd remove cutoff$",
    ),
    "kind changed, keys left": (
        "controller",
        {"kind": "pd", "kp": 1e6, "kd": 1e3, "layer": 1e-3, "observer": {}, "load_estimator": {}},
        r"\[controller\] layer: belongs to kind dobvsc; for kind pd remove layer, observer, load_estimator$",
    ),
    "what a controller takes from the plant": ("controller.mass", 1.0, r"\[controller\] mass: unknown key; known here"),
    "load estimator of another observer": (
        "controller",
        {"kind": "pd+fc+ls", "kp": 1e6, "kd": 1e3, "load_estimator": {"gain": 100.0, "min_speed": 0.005}},
        r"gain: belongs to kind pd\+fc\+le; for kind pd\+fc\+ls remove gain, min_speed$",
    ),
    "gains of a controller that is unknown": (
        "controller",
        {"kind": "unknown", "kp": 1e6, "kd": 1e3},
        r"\[controller\] kp: belongs to kind pd, .*cascade; for kind unknown remove kp, kd$",
    ),
    "cascade over no samples": (
        "controller",
        {"kind": "cascade", "kp": 50.0, "kv": 1e5, "velocity_samples": 0},
        r"\[controller\] velocity_samples: must be a whole number of at least 1",
    ),
    "misspelt observer": (
        "controller",
        {"kind": "pd+fc", "kp": 1e6, "kd": 1e3, "observer": {"positon": 1e-15}},
        r"\[controller.observer\] positon: unknown key; did you mean 'position'\?",
    ),
    "load estimator of another controller": (
        "controller",
        {"kind": "pd+fc", "kp": 1e6, "kd": 1e3, "load_estimator": {"gain": 100.0}},
        r"\[controller.load_estimator\] gain: belongs to kind pd\+fc\+le; for kind pd\+fc remove gain$",
    ),
}


def tampered(place: str, value) -> dict:
    tables = copy.deepcopy(TABLES)
    table, _, key = place.partition(".")
    owner, name = (tables[table], key) if key else (tables, table)
    if value is MISSING:
        del owner[name]
    elif table == "friction" and not key:
        owner[name] |= value
    else:
        owner[name] = value
    return tables


@pytest.mark.parametrize(("place", "value", "says"), FILES.values(), ids=FILES.keys())
def test_a_bad_drive_file_is_refused(place, value, says):
    with pytest.raises(DriveFileError, match="^axis.toml: .*" + says):
        parse_axis(tampered(place, value), "axis.toml")


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ("[plant\nmass = 1", r"drive\.toml: not a TOML file: .*line 1"),
        ("mass = 100 kg", r"drive\.toml: not a TOML file"),
        (b"\xff\xfe", r"drive\.toml: .*\[plant\] mass: is missing"),
        (b"\xff\xfe\x00", r"drive\.toml: is cut off or no text: its byte-order mark says UTF-16; save it as UTF-8$"),
        (
            "[plant]".encode("utf-16-le"),
            r"drive\.toml: is UTF-16 without a byte-order mark, or binary: save it as UTF-8$",
        ),
        (
            "[plant]\n# a mass of 3 \u00b5g".encode("utf-16-be"),
            r"drive\.toml: is UTF-16 without a byte-order mark, or binary: save it as UTF-8$",
        ),
        (
            "[plant]\n# Führung\nmass = 1".encode("latin-1"),
            r"drive\.toml: line 2 holds the byte 0xfc \('ü' in Latin-1\), which is no UTF-8: save the file as UTF-8$",
        ),
        ("a = " + "[" * 2000 + "]" * 2000, r"drive\.toml: not a TOML file: tables or lists are nested too deeply"),
        ("a = " + "{a = " * 2000 + "1" + "}" * 2000, r"drive\.toml: not a TOML file: tables or lists are nested too"),
        ("a = " + 5000 * "1", r"drive\.toml: not a TOML file: Exceeds the limit"),
        ("", r"drive\.toml: .*\[plant\] mass: is missing"),
        (None, r"drive\.toml: no such file; 'diffdrive template > drive\.toml' writes one"),
    ],
)
def test_a_file_that_cannot_be_read_is_refused(content, says, tmp_path):
    path = tmp_path / "drive.toml"
    if content is not None:
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(DriveFileError, match=says):
        read_axis(path)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "utf-32"])
def test_a_drive_file_is_read_in_every_encoding_that_names_itself(encoding, tmp_path):
    """As `diffdrive template > drive.toml` writes it in Windows PowerShell, too."""
    text = "# Führung\n" + tomli_w.dumps(TABLES)
    path = tmp_path / "drive.toml"
    mark = "\ufeff" if encoding.endswith(("-le", "-be")) else ""
    path.write_bytes((mark + text).replace("\n", "\r\n").encode(encoding))
    assert axis_tables(read_axis(path)) == TABLES


def test_a_folder_is_not_a_drive_file(tmp_path):
    with pytest.raises(DriveFileError, match="is a folder, not a file"):
        read_axis(tmp_path)
    (tmp_path / "file").touch()
    with pytest.raises(DriveFileError, match="cannot be read"):
        read_axis(tmp_path / "file" / "drive.toml")
