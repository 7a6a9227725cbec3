"""Searches that survive a kill: where each start stands, in one file that is never half written."""

import dataclasses
import hashlib
import json
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jaxtyping import PyTree

from diffdrive.errors import CheckpointError
from diffdrive.support.atomic_write import write_text
from tuning.gains.sequential import SearchState


class Checkpoint:
    """Standings by start in a JSON file; without a path nothing is kept.

    The file names the problem by the hash of every number and setting in it. Floats are written so that they read back
    to the last bit, and the file is replaced as a whole.
    """

    def __init__(self, path: Path | None, problem: PyTree) -> None:
        """Read what is at `path`, if anything; raises `CheckpointError` if it is another problem's, or damaged."""
        self.path = path
        self.identity = _identity(problem)
        self.states: dict[int, SearchState] = {}
        if path is None or not path.exists():
            return
        try:
            content = json.loads(path.read_text(encoding="utf-8"))
            identity = content["problem"]
            states = {int(k): _search_state(fields) for k, fields in content["standings"].items()}
        except (ValueError, KeyError, TypeError, AttributeError) as damage:
            raise CheckpointError(f"{path}: is no checkpoint of a tuning ({damage}): delete it") from None
        if identity != self.identity:
            raise CheckpointError(
                f"{path}: is the checkpoint of another tuning (other drive, scenarios or settings): delete it to begin "
                "anew, or name another folder"
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
        write_text(self.path, json.dumps(content))


def _search_state(fields: dict[str, Any]) -> SearchState:
    history = tuple(tuple(entry) for entry in fields["history"])
    best = None if fields["best"] is None else tuple(fields["best"])
    return SearchState(**{**fields, "theta": tuple(fields["theta"]), "history": history, "best": best})


def _identity(problem: PyTree) -> str:
    """A hash of every number and every setting."""
    leaves, tree = jax.tree.flatten(problem)
    digest = hashlib.sha256(str(tree).encode())
    for leaf in leaves:
        digest.update(np.asarray(leaf).tobytes() if not isinstance(leaf, str) else leaf.encode())
    return digest.hexdigest()
