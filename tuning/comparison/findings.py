"""What has changed, in sentences: one for each parameter, and one for what is one thing in the workshop."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

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
COULOMB, MASS, PLAY = "friction.coulomb_at_no_load", "plant.mass", "encoders.play"
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


def friction_change(machine: MachineChanges) -> Interval:
    """The relative change of the Coulomb friction, mean of the directions; zero where it has not changed."""
    both = [one.change for one in machine.of(COULOMB) if one.has_changed]
    if not both:
        return Interval(0.0, 0.0, 0.0)
    return Interval(*(float(np.mean([getattr(one, end) for one in both])) for end in ("value", "low", "high")))


def findings_of(
    machine: MachineChanges, controller: ControllerChanges, encoders: EncoderChanges
) -> tuple[Finding, ...]:
    """Everything that has changed, a sentence each; lost preload, which is friction down and play up, is one."""
    found = []
    friction, play = machine.of(COULOMB), encoders.play
    loosened = (
        COULOMB in machine.changed
        and all(one.change.high < 0.0 for one in friction)
        and play is not None
        and play.low > 0.0
    )
    others = {one for rival in machine.explanations[1:] for one in rival}
    for parameter in machine.changed:
        if loosened and parameter == COULOMB:
            continue
        more = ": a payload, or a heavier table" if parameter == MASS and machine.of(MASS)[0].change.low > 0.0 else ""
        if any(parameter not in rival for rival in machine.explanations[1:]):
            instead = sorted(others - set(machine.changed))
            more += f"; a change of {' or '.join(LABELS.get(one, one) for one in instead)} explains as much"
        found.append(Finding(parameter, sentence(machine.of(parameter), more)))
    found += [Finding(path, text) for path, text in controller.sentences]
    reversal = next((one for one in encoders.changes if one.path == "encoders.reversal_error"), None)
    if loosened and reversal is not None and play is not None:
        found.insert(0, Finding(LOST_PRELOAD, f"lost preload: {sentence(friction)}, and {_played(play, reversal)}"))
    elif play is not None and reversal is not None and (play.low > 0.0 or play.high < 0.0):
        found.append(Finding(PLAY, _played(play, reversal)))
    for change in encoders.changes:
        explained = change is reversal and play is not None and not play.low <= 0.0 <= play.high
        if change.has_changed and not explained:
            more = ", as the wind-up of the screw does under the changed friction" if change is reversal else ""
            found.append(Finding(change.path, sentence([change], more)))
    return tuple(found)


def _played(play: Interval, reversal: Change) -> str:
    """How the play has changed, by the reversal error."""
    verb = "rose" if play.value > 0 else "fell"
    was, now = (f"{reversal.factor * one:.3g}" for one in (reversal.before, reversal.after))
    return (
        f"the play {verb} by {sized(play, 1e6, 'um')}: the reversal error of motor against table went from {was} to "
        f"{now} um"
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
    listed = ", ".join(f"{label.removeprefix('the ')} {_least(one)}" for label, one in least.items())
    return f"nine in ten changes of this size would have been found: {listed}"


def _least(one: Change) -> str:
    """In the parameter's unit too, where the change is a share."""
    if not one.is_relative or one.smallest is None:
        return one.least
    unit = "" if one.unit == "1" else f" {one.unit.replace('*', ' ')}"
    return f"{one.smallest * abs(one.before):.2g}{unit} ({one.least})"
