"""A drive with effects on another log: the machine as it is, the session registered anew.

Phases, times and offsets differ from session to session, and a position may count from another place. They are fitted
to the beginning of the new log, the offset within the tolerance of a nominal parameter; all else of the drive stays.
"""

import dataclasses

import jax
import numpy as np

from diffdrive.effects.forces import ConstantForce
from diffdrive.errors import LogError
from diffdrive.logs import Log
from diffdrive.model.parameters import Drive
from tuning.diagnosis.diagnose import logged_of
from tuning.diagnosis.fits.fitting import Fitter
from tuning.diagnosis.gap.gap import drive_of
from tuning.diagnosis.hypotheses.calibration import NAMES, TOLERANCE
from tuning.diagnosis.hypotheses.catalogue import candidates
from tuning.diagnosis.hypotheses.model import Member, Model, counted_in
from tuning.diagnosis.hypotheses.priors import Parameter
from tuning.diagnosis.hypotheses.setting import setting
from tuning.diagnosis.selection.screening import begin
from tuning.diagnosis.selection.search import initial_trajectory
from tuning.identification.problem import MIN_LANE_SAMPLES

REGISTERED = 5.0  # s of a log, by which it is registered
AWAY = 10.0  # standard deviations of its prior: a time out there, such as that of a load that is never taken off, stays


def registered(drive: Drive, log: Log, seconds: float = REGISTERED) -> Drive:
    """`drive` with the session parameters of its effects, and a constant force, from the first seconds of `log`.

    Raises `LogError` for a log without a long enough piece, in those seconds or at all.
    """
    logged = logged_of(drive, [log])
    time = np.asarray(logged.starts)[:, None] + logged.sampling.period * np.arange(logged.lanes.position.shape[1])
    logged = logged._replace(lanes=logged.lanes._replace(counts=logged.lanes.counts * (time < seconds)))
    if not np.any(logged.lanes.counts):
        raise LogError(f"{log.name}: no stretch of {MIN_LANE_SAMPLES} samples without a gap in its first {seconds:g} s")
    at = setting(logged.drive, logged.lanes, logged.sampling.period, logged.thinning, logged.starts)
    known = {one.name: one for one in candidates(at)}
    model, theta = Model(logged), np.zeros(len(NAMES))
    mine = [counted_in(one, logged.thinning) for one in drive.effects]
    effects = [one for one in mine if not isinstance(one, ConstantForce)]
    offset = sum(float(one.force) for one in drive.effects if isinstance(one, ConstantForce))
    for effect in (*effects, ConstantForce(offset)):
        candidate, values = known[effect.name], {}
        for field in dataclasses.fields(effect):
            values[field.name] = np.array([float(getattr(effect, field.name) or 0.0)])
        free = tuple(
            one
            for one in candidate.parameters
            if one.session and (one.amplitude or abs(one.standard(values[one.name][0])) < AWAY)
        )
        if isinstance(effect, ConstantForce):
            free = (Parameter("force", float(effect.force), TOLERANCE * at.friction),)
        fixed = tuple((name, float(value[0])) for name, value in values.items() if name not in {p.name for p in free})
        member = Member(candidate._replace(parameters=free), fixed)
        model = dataclasses.replace(model, members=(*model.members, member))
        theta = np.r_[theta, begin(model, values)]
    free = np.r_[np.zeros(len(NAMES)), np.ones(model.size - len(NAMES))]
    found = Fitter(logged).fit(model, theta, None, initial_trajectory(logged), free=free)
    return jax.tree.map(float, drive_of(found, 0))
