"""How near `identify_controller` comes on traces whose loop is known: `python -m experiments.studies.known_controllers
FOLDER`.

FOLDER is one of `known_machines`. Only machines with a trace slower than its loop count: their drive file names no
controller, and no rate of it.
"""

import argparse
import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

import tuning
from diffdrive.axis_file.drive_file import read_axis
from diffdrive.runtime import configure
from experiments.studies.known_machines import LOGS

GAINS = ("kp", "kv", "reset_time")
WIDE = 0.05  # half of an interval, relative, beyond which a log does not show a gain


class Found(NamedTuple):
    """One gain: its error and the ends of its interval, relative to the truth."""

    error: float
    low: float
    high: float

    @property
    def is_shown(self) -> bool:
        """Whether the interval is narrow enough to tell the gain."""
        return self.high - self.low < 2.0 * WIDE

    @property
    def holds(self) -> bool:
        """Whether the interval has the truth."""
        return self.low <= 0.0 <= self.high


def true_gains(controller: Sequence[float]) -> dict[str, float]:
    """By name, of the list in key.json: kind, K_v (1/s), velocity gain (N s/m), its integral (N/m), and others."""
    _, kp, kv, ki, *_ = controller
    return {"kp": kp, "kv": kv, "reset_time": kv / ki}


def study_case(folder: Path, name: str, controller: Sequence[float]) -> dict[str, Found]:
    """The gains of one machine's loop, from its two sound logs."""
    axis = read_axis(folder / name / "rough.toml")
    estimate = tuning.identify_controller(axis, [folder / name / f"{log}.parquet" for log in LOGS])
    found = {}
    for gain, truth in true_gains(controller).items():
        one = estimate.gain(gain)
        found[gain] = Found(*(value / truth - 1.0 for value in (one.value, one.low, one.high)))
    return found


def study(folder: Path) -> Iterator[tuple[str, Mapping[str, object], dict[str, Found]]]:
    """Each slower trace: its name, the facts of its key, and its gains."""
    key = json.loads((folder / "key.json").read_text(encoding="utf-8"))
    for name, facts in sorted(key.items()):
        if facts["trace_rate"] != facts["control_rate"]:
            yield name, facts, study_case(folder, name, facts["controller"])


def summary(found: Sequence[dict[str, Found]]) -> str:
    """How many gains are shown, how near these are, and how many of all intervals hold."""
    lines = []
    for gain in GAINS:
        every = [one[gain] for one in found]
        shown = [100.0 * abs(one.error) for one in every if one.is_shown]
        worst = f"median {np.median(shown):.2f} %, worst {max(shown):.2f} %" if shown else "none"
        lines.append(
            f"{gain}: shown to {100.0 * WIDE:g} % by {len(shown)} of {len(every)}: {worst}; "
            f"{sum(one.holds for one in every)} of {len(every)} intervals hold the truth"
        )
    return "\n".join(lines)


def main() -> None:
    """Print a row for each trace."""
    parser = argparse.ArgumentParser(description=__doc__.partition(":")[0])
    parser.add_argument("folder", type=Path, help="has key.json and the cases")
    given = parser.parse_args()
    configure()
    print("| case | rows, Hz | samples of the velocity | K_v, % | velocity gain, % | reset time, % |")
    print("|---|---|---|---|---|---|")
    every = []
    for name, facts, found in study(given.folder):
        every.append(found)
        cells = " | ".join(
            f"{100.0 * one.error:+.2f} ({100.0 * one.low:+.2f} to {100.0 * one.high:+.2f})" for one in found.values()
        )
        print(f"| {name} | {facts['trace_rate']:g} | {facts['controller'][-1]:g} | {cells} |", flush=True)  # type: ignore[index]
    print(f"\n{summary(every)}")


if __name__ == "__main__":
    main()
