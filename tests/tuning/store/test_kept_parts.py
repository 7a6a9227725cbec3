"""Finished parts of a computation are found again to the last bit, and no others are taken for them."""

import dataclasses
import importlib
import linecache
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from diffdrive.effects.catalogue import EFFECTS
from diffdrive.model.parameters import Sampling
from experiments.cli.ending import CONTINUED
from experiments.reports.diagnosis import diagnosis as diagnose
from experiments.reports.identification import identification as identify
from experiments.reports.sweep import sweep
from experiments.studies import real_axes
from tests.support import constant_force_log
from tests.support.sound_log import DRIVE
from tuning.diagnosis.diagnose import logged_of
from tuning.diagnosis.fits.fitting import Fitter
from tuning.diagnosis.hypotheses.calibration import TOLERANCE
from tuning.diagnosis.hypotheses.catalogue import candidates
from tuning.diagnosis.hypotheses.priors import ITSELF, LOG_ODDS, LOGARITHM, Parameter
from tuning.diagnosis.hypotheses.setting import setting
from tuning.diagnosis.selection.search import recalibrated, select_next_effect
from tuning.gains.checkpoint import CHECKPOINT
from tuning.gains.objective import AGGREGATIONS
from tuning.identification.row_force import BetweenRows
from tuning.store import edition
from tuning.store.folder import FolderStore
from tuning.store.store import digest


def test_a_part_is_read_as_it_was_written_and_a_damaged_one_is_none(tmp_path):
    parts = FolderStore(tmp_path / "parts")
    assert parts.read("one") is None
    part = {"x": np.nextafter(np.array([[0.1, -0.0], [np.inf, np.nan]]), 1.0), "steps": np.array(3), "a b": np.zeros(0)}
    parts.write("one", part)
    found = FolderStore(tmp_path / "parts").read("one")
    assert found.keys() == part.keys()
    assert all(found[name].tobytes() == part[name].tobytes() for name in part)
    assert all((found[name].dtype, found[name].shape) == (part[name].dtype, part[name].shape) for name in part)
    (path,) = (tmp_path / "parts").iterdir()
    path.write_bytes(path.read_bytes()[:-40])
    assert parts.read("one") is None
    np.savez(path, x=np.array([print], dtype=object))  # a pickle, which could run anything
    assert parts.read("one") is None
    parts.remove()
    assert not (tmp_path / "parts").exists()


def test_what_commands_continue_from_is_said_when_they_are_interrupted():
    names = (diagnose.PARTS, identify.PARTS, real_axes.PARTS, CHECKPOINT, sweep.PARTS)
    assert set(names) < set(CONTINUED)


def test_a_digest_tells_apart_whatever_differs():
    values = [
        None, 0, 0.0, False, "0", np.float64(0), np.zeros(1), np.zeros((1, 1)), np.zeros(1, np.float32), (0,), [0], (),
        0.1, np.nextafter(0.1, 1), {"a": 1}, {"b": 1}, ((1,), 2), (1, (2,)), Sampling(1e3), Sampling(2e3), Parameter,
        *BetweenRows,
        *(Parameter("a", 0.5, 1.0, scale) for scale in (ITSELF, LOGARITHM, LOG_ODDS)), *EFFECTS.values(), DRIVE.drive,
        dataclasses.replace(DRIVE.drive, plant=dataclasses.replace(DRIVE.drive.plant, mass=1.0)),
    ]  # fmt: skip
    assert len({digest(one) for one in values}) == len(values)
    assert digest(np.arange(3.0)) == digest(jnp.arange(3.0))
    with pytest.raises(TypeError, match="no digest of a object"):
        digest(object())


OWN = """
import diffdrive as dd

@dd.effects.register
class Weight(dd.effects.TableForce):
    name = "weight"
    force: float = dd.effects.amplitude("N", "on the table", usual=20.0)

    def push(self, seen):
        return {sign}self.force
"""


def test_another_source_of_an_effect_of_ones_own_is_another_edition(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    found = [edition.code_digest()]
    try:
        for sign in ("", "-", ""):
            (tmp_path / "own_weight.py").write_text(OWN.format(sign=sign))
            sys.modules.pop("own_weight", None)
            linecache.clearcache()
            importlib.import_module("own_weight")
            found.append(edition.code_digest())
        assert found[1] == found[3]
        assert len(set(found)) == 3
        exec(OWN.format(sign=""), {"__name__": "typed"})  # nobody can say what its source is
        assert edition.code_digest() not in found
        assert edition.code_digest() == edition.code_digest()
    finally:
        EFFECTS.remove("weight")
        sys.modules.pop("own_weight", None)


OBJECTIVE = """
import tuning

@tuning.register_aggregation("sum")
def total(costs):
    return {factor} * costs.sum()
"""


def test_another_source_of_an_objective_of_ones_own_is_another_edition(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    found = [edition.code_digest()]
    try:
        for factor in (1.0, 2.0):
            (tmp_path / "own_objective.py").write_text(OBJECTIVE.format(factor=factor))
            sys.modules.pop("own_objective", None)
            linecache.clearcache()
            importlib.import_module("own_objective")
            found.append(edition.code_digest())
        assert len(set(found)) == 3
    finally:
        AGGREGATIONS.remove("sum")
        sys.modules.pop("own_objective", None)


class Interrupted(FolderStore):
    """Parts of a run that is interrupted once it has kept so many."""

    def __init__(self, folder, after):
        super().__init__(folder)
        self.left = after

    def write(self, key, piece):
        super().write(key, piece)
        self.left -= 1
        if not self.left:
            raise KeyboardInterrupt


def looked(store):
    """One effect looked for in a log, out of one that is screened to first order and one that is tried."""
    fitter = Fitter(logged_of(DRIVE.drive, [constant_force_log.log()]), None, store)
    logged = fitter.logged
    at = setting(logged.drive, logged.lanes, logged.sampling.period, logged.thinning, logged.starts)
    few = [one for one in candidates(at) if one.name in ("constant_force", "loop_delay")]
    return select_next_effect(fitter, recalibrated(fitter, TOLERANCE), few, lambda *_: None, lambda _: 0.0)


@pytest.mark.long
def test_a_search_that_was_interrupted_ends_as_if_it_had_not_been(tmp_path):
    for after in (1, 3):
        with pytest.raises(KeyboardInterrupt):
            looked(Interrupted(tmp_path, after))
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    parts = FolderStore(tmp_path)
    found, alone = looked(parts), looked(None)
    assert parts.hits >= 3
    assert before.items() <= {path.name: path.read_bytes() for path in tmp_path.iterdir()}.items()
    for ours, theirs in zip([*found.screened, *found.fits], [*alone.screened, *alone.fits], strict=True):
        for one, other in zip(jax.tree.leaves(numbers_of(ours)), jax.tree.leaves(numbers_of(theirs)), strict=True):
            np.testing.assert_array_equal(one, other)


def numbers_of(found):
    """Whatever is a number or an array of a `Screened` or a `Fitted`."""
    return {name: one for name, one in found._asdict().items() if name not in ("candidate", "model")}
