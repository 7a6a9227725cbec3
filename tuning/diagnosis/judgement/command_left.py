"""Whether what a fit leaves follows the command: residual analysis (Ljung 1999, System Identification, section 16.6).

The filter may invent forces, lasting and sudden ones, but none that follows the command, time and again. A model whose
actuator answers as late as the machine's and yet differently, by a delay in the place of a lag, leaves innovations that
go with the commands of the samples before them, little as each is off.
"""

from typing import cast

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.ndimage import convolve1d
from scipy.stats import chi2

from diffdrive.effects.actuator import LoopDelay
from diffdrive.effects.base import ActuatorEffect
from diffdrive.model.actuator import saturate
from diffdrive.model.current_loop import mean_forces
from tuning.diagnosis.blocks import block_sums
from tuning.diagnosis.filter.effect_signals import EffectSignals
from tuning.diagnosis.fits.curvature import solved
from tuning.diagnosis.fits.fitted import Fitted, last_candidate, residual_jvp
from tuning.diagnosis.fits.reduced import reduced
from tuning.diagnosis.gap.gap import sliding
from tuning.diagnosis.hypotheses.model import delay_of
from tuning.diagnosis.judgement.verdict import Verdict
from tuning.diagnosis.levels import CHANCE, WORTH
from tuning.diagnosis.selection.explanation import Explanation
from tuning.identification.controller.signals import LOW_PASS

TAPS = 5  # samples, the first of them one sooner than the delay that was found, if that is one or more
SHARE = 0.1  # of the command that each sample may add, one standard deviation
QUICK = 20.0  # scatters of the measurement a sample: a slower table's counts are no noise, and the command follows them
FOLLOWING = float(chi2.isf(CHANCE, TAPS))  # of -2 log likelihood: by chance the last commands explain no more; and
FOLLOWS = 0.003  # of what was gained, or of what an effect between command and force gained: more is structure
CLOCKS = 1000.0  # of -2 log likelihood: more than clocks make that are a microsecond apart


def follows_command(fitted: Fitted) -> float:
    """By how much (-2 log likelihood) a force that is a sum of the last commands, added to a fit without effects within
    its filter, would explain the logs better, to first order and all that is free moved to make way.

    Where the table is slow, the counts of its scale are no noise, and the command follows them: it tells nothing, nor
    where it hardly slides, and its friction may be anything. Of a command that had to be told from its loop's noise the
    slow part alone is asked: the fast one goes with the noise of the rows, and did not act.
    """
    logged, velocity = fitted.model.logged, np.asarray(fitted.filtered.trajectory.velocity)
    quick = np.abs(velocity) * logged.sampling.period >= QUICK * float(logged.noise)
    telling = (quick & (sliding(velocity, logged.sampling.rate) > 0.0)).reshape(-1, 1)
    answers = np.where(telling, _answers(fitted), 0.0)
    curvature, slope, left, making_way = reduced(fitted, answers)
    amounts = -solved(curvature + np.eye(TAPS) / SHARE**2, slope)
    residual = fitted.residual - fitted.jacobian @ left
    added = answers @ amounts - fitted.jacobian @ (making_way @ amounts)
    gained = (-added * (2.0 * residual + added)).reshape(velocity.shape)
    return float(np.sum(np.clip(block_sums(gained, logged.sampling.rate), -WORTH, WORTH)))


def downgraded_by_command(verdict: Verdict, found: Explanation) -> Verdict:
    """No sure cause that leaves what follows the command, and among them an effect between command and force.

    Without such an effect much has to: half a microsecond between the clocks of scale and command is seen this way (150
    of -2 log likelihood), and makes no tilt less of a tilt. Effects whose details differ may leave that, and behind
    those within the filter it cannot be told.
    """
    best = found.best
    if verdict.verdict != "effect" or best.model.coarse or best.model.coupled:
        return verdict
    signals = [one for one in found.accepted if issubclass(last_candidate(one.fits[0]).effect, ActuatorEffect)]
    gains = [one.before.cost - one.fits[0].cost for one in signals] or [found.base.cost - best.cost]
    if not follows_command(best) > max(FOLLOWING if signals else CLOCKS, FOLLOWS * min(gains)):
        return verdict
    return verdict.downgraded(
        "what is left follows the command: the actuator, or what lies between it and the table, answers otherwise"
    )


def _answers(fitted: Fitted) -> Float[np.ndarray, "m taps"]:
    """Of the residuals, to each of the last commands added to the force."""
    force = _last_commands(fitted)
    none = jnp.zeros_like(force)
    return residual_jvp(fitted, EffectSignals(force, none, none, none, none, none, none))


def _last_commands(fitted: Fitted) -> Float[Array, "lanes n taps"]:
    """From one sample sooner than the delay that the model has, if that is one or more, to older ones."""
    logged = fitted.model.logged
    delays = [effect.delay for effect in fitted.model.effects(fitted.theta) if isinstance(effect, LoopDelay)]
    late = float(delay_of(logged, fitted.recalibrated_drive)) + sum(float(np.max(one)) for one in delays)
    actuator, period = logged.drive.actuator, logged.sampling.period
    limited = cast(Array, saturate(actuator, logged.lanes.command))  # of an array, it is one
    command = jax.vmap(lambda requests: mean_forces(actuator, requests, period))(limited)
    if float(logged.command_std) > 0.0:
        command = jnp.asarray(convolve1d(command, LOW_PASS, axis=1, mode="nearest"))
    held_back = [max(0, int(late) - 1) + k for k in range(TAPS)]
    count = command.shape[1]
    return jnp.stack([jnp.pad(command, ((0, 0), (k, 0)), mode="edge")[:, :count] for k in held_back], axis=-1)
