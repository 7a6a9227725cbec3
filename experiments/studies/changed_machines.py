"""What `diagnose` says of machines that changed: `python -m experiments.studies.changed_machines FOLDER --out FILE`.

FOLDER has key.json and for each machine rough.toml, a data sheet; healthy-1 and healthy-2, logs of its sound state;
log-a and log-b, logs of today. The way of a workshop: the drive is identified from the sound logs, and the logs of
today are diagnosed with it; the sound logs, too, which lack nothing. Each machine is a line of FILE; those there are
not done again.
"""

import argparse
import json
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TypedDict

import tuning
from diffdrive.axis import Axis
from diffdrive.axis_file.drive_file import read_axis
from diffdrive.runtime import configure
from experiments.studies.resumed import resumed

SOUND, TODAY = ("healthy-1", "healthy-2"), ("log-a", "log-b")


class Answer(TypedDict):
    """What is said of two logs."""

    verdict: str
    says: str
    found: list[tuple[str, float]]  # effects, and how sure each is
    closed: float | None  # share of the gap that is held out
    seconds: float  # of processor time


class Case(TypedDict):
    """One machine, as a line of the output."""

    case: str
    family: str
    kind: str
    true: list[str]
    identified: str  # the status
    rates: tuple[float, float]  # Hz, of the control and of the rows, as identified
    sound: Answer
    today: Answer


def diagnosed(axis: Axis, paths: Sequence[Path]) -> Answer:
    """The diagnosis of some logs."""
    begun = time.process_time()
    found = tuning.diagnose(axis, paths)
    return Answer(
        verdict=found.verdict,
        says=found.says,
        found=[(one.effect, one.confidence) for one in found.causes if one.found],
        closed=None if found.closed is None else found.closed.share,
        seconds=time.process_time() - begun,
    )


def study_case(folder: Path, name: str, facts: dict[str, object], true: list[str]) -> Case:
    """One machine identified and diagnosed."""

    def logs(names: Sequence[str]) -> list[Path]:
        return [folder / name / f"{one}.parquet" for one in names]

    known = tuning.identify(read_axis(folder / name / "rough.toml"), logs(SOUND), force=True)
    return Case(
        case=name,
        family=str(facts["family"]),
        kind=str(facts["kind"]),
        true=true,
        identified=known.status.code or "ok",
        rates=(known.axis.rate, known.axis.log_rate),
        sound=diagnosed(known.axis, logs(SOUND)),
        today=diagnosed(known.axis, logs(TODAY)),
    )


def study(folder: Path, cases: Sequence[str], out: Path) -> Iterator[Case]:
    """Each case, those in `out` first, the others as they are done."""
    key = json.loads((folder / "key.json").read_text(encoding="utf-8"))

    def one(name: str) -> Case:
        return study_case(folder, name, key[name], [effect["name"] for effect in key[name]["effects"]])

    yield from resumed(out, cases or sorted(key), one)


def _said(answer: Answer) -> str:
    found = ", ".join(f"{name} {confidence:.2f}" for name, confidence in answer["found"])
    return f"{answer['verdict']}{f': {found}' if found else ''}"


def main() -> None:
    """Print a row for each case."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("folder", type=Path, help="has key.json and the cases")
    parser.add_argument("--case", action="append", default=[], help="of these cases only")
    parser.add_argument("--out", type=Path, required=True, help="a line of JSON for each case; goes on from it")
    given = parser.parse_args()
    configure()
    print(
        "| case | family | true | sound logs | logs of today | closed | processor, s |\n|---|---|---|---|---|---|---|"
    )
    for one in study(given.folder, given.case, given.out):
        closed = "-" if one["today"]["closed"] is None else f"{one['today']['closed']:.3f}"
        print(
            f"| {one['case']} | {one['family']} | {', '.join(one['true']) or '-'} | {_said(one['sound'])} "
            f"| {_said(one['today'])} | {closed} | {one['today']['seconds']:.0f} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
