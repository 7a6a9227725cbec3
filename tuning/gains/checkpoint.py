"""Searches that survive a kill: where each start stands, in one file that is never half written."""

import dataclasses
import json
from pathlib import Path
from typing import Any

from diffdrive.errors import CheckpointError
from diffdrive.runtime import arithmetic_signature
from diffdrive.support.atomic_write import write_text
from tuning.gains.sequential import SearchState
from tuning.store.edition import code_digest
from tuning.store.store import digest

CHECKPOINT = "tuning.checkpoint.json"


class Checkpoint:
    """Standings by start in a JSON file of a folder; without a folder nothing is kept.

    The file names the problem by a digest of every number, name and setting in it, of the code, and of the arithmetic.
    Floats are written so that they read back to the last bit, and the file is replaced as a whole.
    """

    def __init__(self, folder: str | Path | None, problem: object) -> None:
        """Read what is in `folder`, if anything; raises `CheckpointError` if it is another problem's, or damaged."""
        self.states: dict[int, SearchState] = {}
        self.path = None if folder is None else Path(folder) / CHECKPOINT
        if self.path is None:
            return
        self.identity = digest(code_digest(), arithmetic_signature(), problem)
        if not self.path.exists():
            return
        try:
            content = json.loads(self.path.read_text(encoding="utf-8"))
            identity = content["problem"]
            states = {int(k): _search_state(fields) for k, fields in content["standings"].items()}
        except (ValueError, KeyError, TypeError, AttributeError) as damage:
            raise CheckpointError(f"{self.path}: is no checkpoint of a tuning ({damage}): delete it") from None
        if identity != self.identity:
            raise CheckpointError(
                f"{self.path}: is the checkpoint of another tuning (other drive, scenarios, settings, code or "
                "processor): delete it to start over, or name another folder"
            )
        self.states = states

    def state_of(self, start: int) -> SearchState | None:
        """Where this start stands; an interrupted one goes on."""
        return self.states.get(start)

    def save(self, start: int, state: SearchState) -> None:
        """Write where this start stands."""
        self.states[start] = state
        if self.path is None:
            return
        states = {str(k): dataclasses.asdict(standing) for k, standing in self.states.items()}
        content = {"problem": self.identity, "standings": states}
        self.path.parent.mkdir(parents=True, exist_ok=True)
        write_text(self.path, json.dumps(content))


def _search_state(fields: dict[str, Any]) -> SearchState:
    history = tuple(tuple(entry) for entry in fields["history"])
    best = None if fields["best"] is None else tuple(fields["best"])
    return SearchState(**{**fields, "theta": tuple(fields["theta"]), "history": history, "best": best})
