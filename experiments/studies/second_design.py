"""What the second design of the diagnosis finds: `python -m experiments.studies.second_design FOLDER --out FILE`.

FOLDER has key.json and a folder for each machine, with drive.toml and its logs (Parquet), as the bench of known faults.
Each machine is a line of FILE; those there are not done again. Only what is found is said, not how sure it is: that has
yet to be calibrated.
"""

import argparse
import json
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TypedDict

from diffdrive.axis_file.drive_file import read_axis
from diffdrive.runtime import configure
from experiments.studies.resumed import resumed
from tuning.checked_logs import checked
from tuning.diagnosis.diagnose import logged_of
from tuning.diagnosis.fits.goodness_of_fit import is_complete
from tuning.diagnosis.hypotheses.calibration import TOLERANCE
from tuning.diagnosis.hypotheses.candidates import candidates
from tuning.diagnosis.hypotheses.setting import setting
from tuning.diagnosis.selection.explain import MOST_EFFECTS
from tuning.diagnosis.selection.search import recalibrated
from tuning.hypotheses.fitter import OneMassFitter
from tuning.hypotheses.search import Found, Judged, search


class Answer(TypedDict):
    """One machine, as a line of the output; evidences in -2 log likelihood."""

    case: str
    kind: str
    true: list[str]
    found: list[str]
    explained: float  # by what was found
    left: float  # that functions of place, speed, time or command would explain of the rest
    base_left: float  # and before anything was found
    is_complete: bool  # the logs are explained to the noise
    screened: list[list[tuple[str, float]]]  # round by round, best first
    fitted: list[list[tuple[str, float]]]
    seconds: float  # wall clock
    processor: float  # s


def answer(folder: Path, case: str, kind: str, true: Sequence[str]) -> Answer:
    """One machine diagnosed."""
    axis = read_axis(folder / case / "drive.toml")
    (used,) = checked(axis, sorted((folder / case).glob("*.parquet")))
    begun, processor = time.monotonic(), time.process_time()
    logged = logged_of(axis.as_logged().drive, used.logs, axis.loop_samples)
    fitter = OneMassFitter(logged)
    at = setting(logged.drive, logged.lanes, logged.sampling.period, logged.thinning, logged.starts)
    found = search(fitter, recalibrated(fitter, TOLERANCE), candidates(at), at, MOST_EFFECTS)
    return Answer(
        case=case,
        kind=kind,
        true=list(true),
        found=found.effects,
        explained=found.base.plain - found.best.plain,
        left=_left(found.best),
        base_left=_left(found.base),
        is_complete=is_complete(fitter, found.best.fitted),
        screened=[[(one.candidate.name, one.evidence) for one in looked.entries] for looked in found.rounds],
        fitted=_gains(found),
        seconds=time.monotonic() - begun,
        processor=time.process_time() - processor,
    )


def _left(one: Judged) -> float:
    return one.plain - one.free


def _gains(found: Found) -> list[list[tuple[str, float]]]:
    return [
        [(one.model.members[-1].candidate.name, looked.before.plain - one.evidence) for one in looked.fits]
        for looked in found.rounds
    ]


def study(folder: Path, cases: Sequence[str], out: Path) -> Iterator[Answer]:
    """Each case, those in `out` first, the others as they are done."""
    key = json.loads((folder / "key.json").read_text(encoding="utf-8"))

    def one(case: str) -> Answer:
        return answer(folder, case, key[case]["kind"], [effect["name"] for effect in key[case]["effects"]])

    yield from resumed(out, cases or sorted(key), one)


def main() -> None:
    """Print a row for each case."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("folder", type=Path, help="has key.json and the cases")
    parser.add_argument("--case", action="append", default=[], help="of these cases only")
    parser.add_argument("--out", type=Path, required=True, help="a line of JSON for each case; goes on from it")
    given = parser.parse_args()
    configure()
    print("| case | kind | true | found | explained | left | to the noise | s |\n|---|---|---|---|---|---|---|---|")
    for one in study(given.folder, given.case, given.out):
        true, found = (", ".join(sorted(names)) or "-" for names in (one["true"], one["found"]))
        print(
            f"| {one['case']} | {one['kind']} | {true} | {found} | {one['explained']:.0f} | {one['left']:.0f} "
            f"| {'yes' if one['is_complete'] else 'no'} | {one['seconds']:.0f} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
