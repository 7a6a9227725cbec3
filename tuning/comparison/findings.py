"""What has changed, in sentences: one for each parameter, and one for what is one thing in the workshop."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from diffdrive.model.parameters import Friction
from tuning.comparison.change import Change, relative, sentence, sized
from tuning.comparison.changes import Difference, Interval
from tuning.comparison.controller import ControllerChanges
from tuning.comparison.encoders import EncoderChanges
from tuning.comparison.machine import MachineDifference

LABELS = {
    "plant.mass": "the moving mass",
    "plant.constant_force": "the constant force",
    "friction.coulomb_at_no_load": "the Coulomb friction",
    "friction.load_coefficient": "the friction per load",
    "friction.breakaway_gap": "the breakaway gap",
    "friction.stribeck_velocity": "the Stribeck velocity",
    "friction.viscous": "the viscous friction",
    "friction.bristle_stiffness": "the bristle stiffness",
    "friction.bristle_damping": "the bristle damping",
    "actuator.delay": "the delay of the command",
    "screw.compliance": "the wind-up of the screw per newton of friction",
}
COULOMB, MASS, BACKLASH = "friction.coulomb_at_no_load", "plant.mass", "encoders.backlash"
LOST_PRELOAD = "lost preload"


class Finding(NamedTuple):
    """One thing that has changed: its paths, or `lost preload`, as a code for programs, and a sentence."""

    code: str
    sentence: str


class MachineChanges(NamedTuple):
    """Each compared number of the machine, the smallest sets of changes that explain all, the likeliest first."""

    changes: tuple[Change, ...]
    explanations: tuple[tuple[str, ...], ...]
    p_unchanged: float  # how often two logs of one machine would differ as much

    @property
    def changed(self) -> tuple[str, ...]:
        """The parameters of the likeliest set."""
        return self.explanations[0]

    def of(self, parameter: str) -> list[Change]:
        """The changes of a parameter, one for each direction."""
        return [one for one in self.changes if one.path.startswith(parameter)]


def machine_changes(found: MachineDifference, level: float) -> MachineChanges:
    """Which of the machine's parameters differ, and by how much; a false one in a share `level`, or fewer."""
    difference = found.difference
    if difference is None:
        return MachineChanges((), ((),), 1.0)
    explanations = tuple(difference.explanations(level))
    rows = [_change(found, difference, k, explanations[0], level) for k in range(len(found.components))]
    return MachineChanges(tuple(rows), explanations, difference.p_unchanged(difference.names))


def _change(found: MachineDifference, difference: Difference, k: int, changed: Sequence[str], level: float) -> Change:
    """The change of one component: those that have changed are free beside it, and no others."""
    component = found.components[k]
    parameter = component.parameter
    freed = tuple(dict.fromkeys((*changed, parameter)))
    interval = difference.intervals(freed)[difference.rows(freed).index(k)]
    least = difference.smallest(parameter, changed, level)
    if component.is_relative:
        interval, least = relative(interval), float(np.expm1(least))
    return Change(
        component.path, LABELS.get(parameter, component.name), component.unit, *component.values,
        interval, component.is_relative, parameter in changed, least,
    )  # fmt: skip


def friction_change(
    machine: MachineChanges, friction: Friction, load_before: float, load_after: float
) -> Interval | None:
    """The relative change of the Coulomb friction under the loads (N) of the logs, mean of the directions.

    Named or not: what the logs do not exclude may have wound up the screw. None where it is not compared. `friction` is
    that before, whose slope over the load is taken as the same after.
    """
    both = machine.of(COULOMB)
    if not both:
        return None
    without_load = float(np.mean([one.before for one in both]))
    slope = float(np.mean([friction.load_coefficient.positive, friction.load_coefficient.negative]))
    total, by_load = without_load + slope * load_before, slope * (load_after - load_before)
    ends = (float(np.mean([getattr(one.change, end) for one in both])) for end in ("value", "low", "high"))
    return Interval(*((without_load * end + by_load) / total for end in ends))


def scales_friction_alone(machine: MachineChanges) -> bool:
    """Whether the mass has surely not changed by the factor of the friction, as a wrong unit of the command would."""
    mass, friction = machine.of(MASS), machine.of(COULOMB)
    if not mass or not friction:
        return False
    return all(not mass[0].change.low <= one.change.value <= mass[0].change.high for one in friction)


def findings_of(
    machine: MachineChanges, controller: ControllerChanges, encoders: EncoderChanges
) -> tuple[Finding, ...]:
    """Everything that has changed, a sentence each; lost preload, which is friction down and backlash up, is one."""
    found = []
    friction, backlash = machine.of(COULOMB), encoders.backlash
    has_lost_preload = (
        COULOMB in machine.changed
        and all(one.change.high < 0.0 for one in friction)
        and backlash is not None
        and backlash.low > 0.0
    )
    others = {one for rival in machine.explanations[1:] for one in rival}
    for parameter in machine.changed:
        if has_lost_preload and parameter == COULOMB:
            continue
        more = ": a payload, or a heavier table" if parameter == MASS and machine.of(MASS)[0].change.low > 0.0 else ""
        if any(parameter not in rival for rival in machine.explanations[1:]):
            instead = sorted(others - set(machine.changed))
            more += f"; a change of {' or '.join(LABELS.get(one, one) for one in instead)} may be it instead"
        found.append(Finding(parameter, sentence(machine.of(parameter), more)))
    found += [Finding(path, text) for path, text in controller.sentences]
    reversal = next((one for one in encoders.changes if one.path == "encoders.reversal_error"), None)
    is_backlash = backlash is not None and not backlash.low <= 0.0 <= backlash.high
    if has_lost_preload and reversal is not None and backlash is not None:
        found.insert(
            0, Finding(LOST_PRELOAD, f"lost preload: {sentence(friction)}, and {_by_reversal(backlash, reversal)}")
        )
    elif is_backlash and backlash is not None and reversal is not None:
        found.append(Finding(BACKLASH, _by_reversal(backlash, reversal)))
    for change in encoders.changes:
        if change.has_changed and not (change is reversal and is_backlash):
            found.append(
                Finding(change.path, sentence([change], _WIND_UP[backlash is None] if change is reversal else ""))
            )
    return tuple(found)


_WIND_UP = {
    False: ", as the wind-up of the screw may under friction that these logs do not exclude",
    True: ": backlash, or wind-up of the screw under another friction, which is not compared",
}


def _by_reversal(backlash: Interval, reversal: Change) -> str:
    """How the backlash has changed, by the reversal error."""
    verb = "rose" if backlash.value > 0 else "fell"
    was, now = (f"{reversal.factor * one:.3g}" for one in (reversal.before, reversal.after))
    return (
        f"the backlash {verb} by {sized(backlash, 1e6, 'um')}: the reversal error of motor against table went from "
        f"{was} to {now} um"
    )


def limits(changes: Sequence[Change]) -> str:
    """The smallest changes that would have been found, of what has not changed; empty where all has."""
    least: dict[str, Change] = {}
    for one in changes:
        known = least.get(one.label)
        if (
            one.smallest is not None
            and not one.has_changed
            and (known is None or one.smallest > (known.smallest or 0.0))
        ):
            least[one.label] = one
    if not least:
        return ""
    unseen = [label for label, one in least.items() if _beyond_doubling(one)]
    seen = ", ".join(
        f"{label.removeprefix('the ')} {_least(one)}" for label, one in least.items() if label not in unseen
    )
    parts = [f"nine in ten changes of this size would have been found: {seen}"] if seen else []
    if unseen:
        parts.append(
            f"not even twice as much would have been found of: {', '.join(one.removeprefix('the ') for one in unseen)}"
        )
    return "; ".join(parts)


def _beyond_doubling(one: Change) -> bool:
    """Whether a change would have to be larger than the number itself, where such a number has a size of its own."""
    if one.smallest is None:
        return False
    share = one.smallest if one.is_relative else one.smallest / max(abs(one.before), np.finfo(float).tiny)
    return share > 1.0 and (one.is_relative or one.path.startswith("friction."))


def _least(one: Change) -> str:
    """In the parameter's unit too, where the change is a share."""
    if not one.is_relative or one.smallest is None:
        return one.least
    unit = "" if one.unit == "1" else f" {one.unit.replace('*', ' ')}"
    return f"{one.smallest * abs(one.before):.2g}{unit} ({one.least})"
