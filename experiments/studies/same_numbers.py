"""Whether two editions of this repository give the same numbers: the same commands run in each, their files compared.

    python -m experiments.studies.same_numbers OLD NEW OUT

OLD and NEW are checkouts, such as worktrees of two commits. A difference is that of two numbers in the same place, over
the larger; files of one edition alone are named. Prints a Markdown table.
"""

import csv
import json
import math
import os
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

from diffdrive.support.atomic_write import write_text

MAIN = """
import sys
try:
    from experiments.cli.main import main
except ImportError:
    from experiments.cli import main
sys.argv = ["diffdrive", *sys.argv[1:]]
main()
"""
LAP = "sine:amplitude=15mm,frequency=0.5Hz,duration=4s"
SHORT = "sine:amplitude=1mm,frequency=10Hz,duration=0.4s"
COGGING = '\n[effects.cogging]\nperiod = "2.5 mm"\ncosine = 3.0\nsine = 2.0\n'
COMMANDS: dict[str, tuple[str, ...]] = {
    "lap": ("simulate", "drive.toml", "--machine", "machine.toml", "--motion", LAP, "--load", "2kN"),
    "held-out": ("simulate", "drive.toml", "--machine", "machine.toml", "--motion", LAP.replace("0.5Hz", "0.3Hz")),
    "plain": ("simulate", "drive.toml", "--motion", LAP, "--seed", "3"),
    "check": ("check", "lap/run.csv", "--drive", "drive.toml"),
    "swept": (
        "sweep",
        "drive.toml",
        "--motion",
        SHORT,
        "--samples",
        "64",
        "--settle",
        "0.1",
        "--vary",
        "load=uniform:0..8 kN",
    ),
    "tuned": ("tune", "drive.toml", "--starts", "1", "--steps", "4", "--loads", "2", "--machines", "1"),
    "identified": ("identify", "plain/run.csv", "--drive", "drive.toml", "--starts", "2"),
    "diagnosis": ("diagnose", "lap/run.csv", "held-out/run.csv", "--drive", "drive.toml"),
}
NOT_COMPARED = {"seconds", "made_by", "timings_s", "title", "schema", "status", "question", "written"}


def run_commands(checkout: Path, out: Path, drive: str) -> dict[str, int]:
    """Run every command with the code of a checkout; their exit codes."""
    out.mkdir(parents=True, exist_ok=True)
    write_text(out / "drive.toml", drive)
    write_text(out / "machine.toml", drive + COGGING)
    environment = os.environ | {"PYTHONPATH": str(checkout.resolve())}
    codes = {}
    for name, command in COMMANDS.items():
        call = [sys.executable, "-c", MAIN, *command, "--out", name]
        codes[name] = subprocess.run(call, cwd=out, env=environment, stdout=subprocess.DEVNULL, check=False).returncode
    return codes


def numbers(value: object, place: str = "") -> Iterator[tuple[str, float]]:
    """Every number below a value of JSON or TOML, by its place."""
    if isinstance(value, dict):
        for key, item in value.items():
            if key not in NOT_COMPARED:
                yield from numbers(item, f"{place}/{key}")
    elif isinstance(value, list):
        for k, item in enumerate(value):
            yield from numbers(item, f"{place}/{k}")
    elif isinstance(value, int | float) and not isinstance(value, bool):
        yield place, float(value)


def read_numbers(path: Path) -> dict[str, float]:
    """Those of a file."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".json":
        return dict(numbers(json.loads(text)))
    if path.suffix == ".toml":
        return dict(numbers(tomllib.loads(text)))
    values = {}
    for row, cells in enumerate(csv.reader(text.splitlines())):
        for column, cell in enumerate(cells):
            try:
                values[f"{row}/{column}"] = float(cell)
            except ValueError:
                continue
    return values


def relative_difference(a: float, b: float) -> float:
    """How far two numbers are apart, over the larger."""
    if a == b or (math.isnan(a) and math.isnan(b)):
        return 0.0
    return abs(a - b) / max(abs(a), abs(b))


def compare_files(old: Path, new: Path) -> Iterator[list[str]]:
    """A row for each file: numbers in both, how many differ, the largest difference."""
    for path in sorted(path for path in old.rglob("*") if path.suffix in (".csv", ".toml", ".json")):
        name = path.relative_to(old)
        if "parts" in name.parts:
            continue
        if not (new / name).exists():
            yield [str(name), "-", "-", "not written any more"]
            continue
        before, after = read_numbers(path), read_numbers(new / name)
        common = before.keys() & after.keys()
        differences = [relative_difference(before[key], after[key]) for key in common]
        changed = sum(path > 0.0 for path in differences)
        lost = len(before.keys() - after.keys())
        largest = f"{max(differences, default=0.0):.1e}" if changed else "none"
        yield [str(name), str(len(common)), str(changed), largest + (f"; {lost} gone" if lost else "")]


def main(old: Path, new: Path, out: Path) -> None:
    """Run both, and print what differs."""
    drive = (new / "experiments" / "drives" / "paper.toml").read_text(encoding="utf-8")
    drive = drive.replace('# noise = "20 nm"', 'noise = "20 nm"')
    codes = [run_commands(checkout, out / name, drive) for checkout, name in ((old, "old"), (new, "new"))]
    print(f"exit codes alike: {codes[0] == codes[1]} {codes[1]}\n")
    print("| file | numbers in both | that differ | largest relative difference |\n|---|---|---|---|")
    for row in compare_files(out / "old", out / "new"):
        print(f"| {' | '.join(row)} |")


if __name__ == "__main__":
    main(*(Path(one) for one in sys.argv[1:4]))
