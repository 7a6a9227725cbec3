"""Commands that write a page, most within seconds, and the files that they read."""

import dataclasses
import tomllib
from pathlib import Path

import numpy as np

from diffdrive.axis_file.drive_file import parse_axis, write_axis
from diffdrive.logs import write_log
from experiments.studies.demo import PAPER_DRIVE
from tests.support.command_line import run
from tests.support.second_order import two_mass_speed
from tests.support.sound_log import DRIVE, SOUND, simulate_log, two_sines

MOTION = ("--motion", "sine:amplitude=1mm,frequency=10Hz,duration=0.3s")
COGGING = '\n[effects.cogging]\nperiod = "2.5 mm"\ncosine = 3.0\nsine = 2.0\n'
COMMANDS = {
    "template": ("template",),
    "simulate": ("simulate", PAPER_DRIVE, *MOTION),
    "margins": ("margins", PAPER_DRIVE),
    "check": ("check", "lap.csv", "--drive", "drive.toml"),
    "start": ("start", "lap.csv", "--mass", "100kg", "--drive", "started.toml"),
    "sweep": ("sweep", PAPER_DRIVE, *MOTION, "--samples", 8, "--settle", 0.1, "--vary", "plant.mass=normal:3%"),
}
OTHERS = {  # by what they show
    "reproduce": ("reproduce",),
    "keys": ("keys",),
    "motions": ("motions",),
    "axes": ("axes",),
    "controller": ("check", "lap.csv", "--drive", "drive.toml", "--controller"),
    "convergence": ("convergence", "le.toml"),
    "export": ("export", PAPER_DRIVE, "--target", "structured-text", *MOTION),
    "export to hal": ("export", PAPER_DRIVE, "--target", "hal", *MOTION),
    "encoders": ("check", "two.csv", "--drive", "drive.toml"),
    "measured margins": ("margins", "pd.toml", "--measured", "plant.csv", "--of", "plant", "--unit", "(m/s)/N"),
    "identify": ("identify", "lap.csv", "--drive", "drive.toml", "--starts", 1, "--held-out", "lap_2.csv"),
    "compare": ("compare", "lap.csv", "--", "ripple_1.csv", "--drive", "drive.toml", "--starts", 1),
    "diagnose": ("diagnose", "ripple_1.csv", "ripple_2.csv", "--drive", "drive.toml"),
    "tune": (
        "tune", "drive.toml", "--loads", 2, "--machines", 1, "--starts", 1, "--command-noise", "60N",
        "--pareto", "50;70 N",
    ),
    "severity": (
        "severity", "cogging.toml", "--tolerance", "1um", "--speed", "10mm/s", "--acceleration", "0.5m/s^2",
        "--stroke", "0mm", "5mm",
    ),
}  # fmt: skip


def prepare(folder: Path) -> None:
    """Write what the commands read: drives, logs with one encoder, with two and with cogging, a measured plant."""
    write_axis(folder / "drive.toml", DRIVE)
    write_log(folder / "lap.csv", SOUND)
    write_log(folder / "lap_2.csv", simulate_log(DRIVE, two_sines(), seed=2))
    ripple = parse_axis(tomllib.loads((folder / "drive.toml").read_text(encoding="utf-8") + COGGING))
    for seed in (1, 2):
        write_log(folder / f"ripple_{seed}.csv", simulate_log(ripple, two_sines(), seed=10 + seed))
    turned = np.where(np.gradient(SOUND.position) < 0.0, -1.0, 1.0)
    write_log(folder / "two.csv", dataclasses.replace(SOUND, motor_position=SOUND.position + 40e-6 * turned))
    frequency = np.geomspace(2.0, 4_500.0, 100)
    value = two_mass_speed(frequency, 100.0, 400.0, 0.02)
    rows = [f"{f!r},{v.real!r},{v.imag!r},0.9" for f, v in zip(frequency.tolist(), value.tolist(), strict=True)]
    (folder / "plant.csv").write_text("\n".join(["frequency [Hz],real,imaginary,coherence", *rows, ""]))
    for name, kind in (("pd", "pd"), ("le", "pd+fc+le"), ("cogging", "pd+fc+ls")):
        text = run("template", "--controller", kind).output
        if name == "cogging":
            text += COGGING
        (folder / f"{name}.toml").write_text(text, encoding="utf-8")
