"""An axis: the machine, its controller, and how both are sampled, limited and logged."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import equinox as eqx
import jax
import numpy as np
from jaxtyping import PyTree

from diffdrive.controllers import Controller, UnknownController
from diffdrive.effects.base import ActuatorEffect, Effect
from diffdrive.effects.catalogue import in_order
from diffdrive.effects.data_sheet import require_agreement
from diffdrive.errors import ParameterError
from diffdrive.logs.mapping import ColumnMapping
from diffdrive.loop.smooth import smooth
from diffdrive.model.data_sheet import NO_SHEET, DataSheet
from diffdrive.model.parameters import Actuator, Drive, Sampling
from diffdrive.model.quantity import Directional, is_number, node_at, parameter_value, quantities, with_nodes
from diffdrive.model.trace import Trace
from diffdrive.model.uncertainty import Uncertainty
from diffdrive.motion.motion import Limits
from diffdrive.numerics.arrays import Scalar
from diffdrive.support.bounds import require_a
from diffdrive.support.messages import suggestion

PARTS = ("plant", "friction", "actuator", "sensor", "motor_encoder", "effects")  # of the machine


class Axis(eqx.Module):
    """What a drive file holds: the drive, its controller, sampling, limits, how its logs read, and its data sheet.

    `name` is what reports call it. `uncertainty` is that of its parameters, as `identify` found it: `sweep` and `tune`
    draw machines by it, and `diagnose` recalibrates by it.

    A pytree, so that it passes through `jit`, `grad` and `vmap`; no method changes it. The controller's model of the
    machine (its feed-forward, its observer's plant and friction) is the axis's own plant and friction, as in a file. A
    machine that differs from its controller's model is an axis of its own: pass it as `machine`.

    Examples:
        >>> axis = paper_axis(controller="pd+fc+ls")
        >>> heavier = axis.replace({"plant.mass": 130.0, "friction.coulomb_screw": (50.0, 80.0)})
        >>> stiffer = axis.with_gains(kp=1.2 * axis.gains["kp"])

    """

    drive: Drive  # the machine: plant, friction, actuator, encoders, effects
    controller: Controller  # with its own model of the machine, where it has one
    sampling: Sampling  # control rate, and substeps of the plant
    limits: Limits = eqx.field(static=True, default=Limits())
    mapping: ColumnMapping = eqx.field(static=True, default_factory=ColumnMapping)
    name: str = eqx.field(static=True, default="axis")
    trace: Trace = Trace()  # which rows its control writes into a log
    sheet: DataSheet = eqx.field(static=True, default=NO_SHEET)  # what its data sheets say: lead, gear, motor
    uncertainty: Uncertainty | None = eqx.field(static=True, default=None)  # how well plant and friction are known

    @property
    def rate(self) -> float:
        """Control rate (Hz)."""
        return self.sampling.rate

    @property
    def log_rate(self) -> float:
        """Rate of the rows of its logs (Hz)."""
        return self.rate if self.trace.rate is None else float(self.trace.rate)

    @property
    def loop_samples(self) -> int:
        """Samples of the control to a row of its logs, which is a snapshot of one of them; 1 where rows are means."""
        return self.trace.stride(self.rate) if self.trace.sample == "snapshot" else 1

    @property
    def gains(self) -> dict[str, Scalar]:
        """The controller's gains by name, in SI units: those that `with_gains` takes, and that are tuned."""
        return {name: node_at(self.controller, tunable.path) for name, tunable in self.controller.tunables.items()}

    def with_gains(self, **gains: Scalar) -> "Axis":
        """The axis with these gains, numbers, arrays or traced; raises `ParameterError` for an unknown one."""
        tunables = self.controller.tunables
        declared = {path: declaration for path, declaration, _ in quantities(self.controller)}
        values = {}
        for name, gain in gains.items():
            if name not in tunables:
                raise ParameterError(f"{name}: {_unknown('gain', name, tunables)}")
            path = tunables[name].path
            values[path] = parameter_value(name, declared.get(path), gain)
        return replace(self, controller=with_nodes(self.controller, values))

    @property
    def parameters(self) -> dict[str, PyTree]:
        """The machine's parameters by dotted path, such as `plant.mass`: SI numbers, or pairs (positive, negative)."""
        return {path: _number_or_pair(value) for path, _, value in quantities(self.drive)}

    def value(self, path: str) -> PyTree:
        """One of `parameters`; raises `ParameterError` for an unknown path."""
        known = self.parameters
        if path not in known:
            raise ParameterError(f"{path}: {_unknown('parameter', path, known)}")
        return known[path]

    def replace(self, values: Mapping[str, object]) -> "Axis":
        """The axis with other parameters, by dotted path (see `parameters`), in its controller's model, too.

        A parameter that may differ between the directions takes one number or a pair (positive, negative), an optional
        one None. Raises `ParameterError` for an unknown path, or what is no number.
        """
        declared = {path: declaration for path, declaration, _ in quantities(self.drive)}
        for path in values:
            if path not in declared:
                raise ParameterError(f"{path}: {_unknown('parameter', path, declared)}")
        new = {path: parameter_value(path, declared[path], value) for path, value in values.items()}
        return self.with_drive(with_nodes(self.drive, new))

    def with_drive(self, drive: Drive) -> "Axis":
        """The axis with another machine, in its controller's model, too."""
        return replace(self, drive=drive, controller=self.controller.with_model(drive))

    @property
    def unseen_controller(self) -> str:
        """Why its logs do not show all that its controller was given and what it answered; "" where they do."""
        trace = self.trace
        if not self.controller.can_simulate:
            return ""
        stride = trace.stride(self.rate)
        if stride > 1:
            kind = "the mean of" if trace.sample == "mean" else "one in"
            return f"the trace has {kind} {stride} samples of the controller, {self.log_rate:g} of {self.rate:g} Hz"
        if trace.command != "set-point":
            return "the trace has the force that acts, not the command"
        if trace.command_offset is not None:
            return "the trace has the command of another instant than the position"
        if others := self.controller.feedback_encoders - {trace.position_encoder}:
            return f"the controller feeds back the {' and the '.join(sorted(others))} encoder, position is of another"
        return ""

    @property
    def logs_show_delay(self) -> bool:
        """Whether the delay from the command to the force is that of the rows of a log, in control steps."""
        trace = self.trace
        is_set_point = trace.command == "set-point" and trace.command_offset is None
        return is_set_point and trace.stride(self.rate) == 1

    def as_logged(self) -> "Axis":
        """The axis as its logs show it: at the rate of their rows, measured by the encoder that `position` is of.

        What lies between the force and the column `command` is no part of it, the delay is from one to the other. The
        controller is unknown where it is unseen (`unseen_controller`).
        """
        trace, drive = self.trace, self.drive
        if trace == Trace() and not self.unseen_controller:
            return self
        share = self.log_rate / self.rate
        effects, actuator = drive.effects, drive.actuator
        delay = actuator.delay_samples + float(actuator.delay_fraction or 0.0)
        if trace.command == "force":
            effects, delay = tuple(one for one in effects if not isinstance(one, ActuatorEffect)), 0.0
            actuator = Actuator(actuator.force_limit, actuator.limit_rounding)  # all else is before the column
        rows = max(0.0, share * delay + float(trace.command_offset or 0.0) * self.log_rate)
        own = replace(actuator, delay_samples=int(rows), delay_fraction=rows % 1.0 or None)
        seen = replace(drive, actuator=own, effects=tuple(one.at_rate(share) for one in effects))
        if trace.position_encoder == "motor" and drive.motor_encoder is not None:
            seen = replace(seen, sensor=drive.motor_encoder)
        controller = UnknownController() if self.unseen_controller else self.controller
        sampling = self.sampling if share == 1.0 else Sampling(self.log_rate)
        return replace(self, drive=seen, controller=controller, sampling=sampling, trace=Trace())

    def with_logged_drive(self, drive: Drive) -> "Axis":
        """The axis with a machine that was found from its logs: `as_logged` with other numbers.

        Encoders stay as they are, and what lies between the controller and the logged command; so does the actuator,
        where logs do not show its delay.
        """
        if self.as_logged() is self:
            return self.with_drive(drive)
        share, own = self.log_rate / self.rate, self.drive
        kept = [one for one in own.effects if self.trace.command == "force" and isinstance(one, ActuatorEffect)]
        effects = in_order((*kept, *(one.at_rate(1.0 / share) for one in drive.effects)))
        actuator = drive.actuator if self.logs_show_delay else own.actuator
        return self.with_drive(
            replace(own, plant=drive.plant, friction=drive.friction, actuator=actuator, effects=effects)
        )

    def with_controller(self, controller: Controller) -> "Axis":
        """The axis under another controller. Raises `ParameterError` for what is none."""
        require_a(Controller, "controller", controller, "make one with diffdrive.controllers")
        return replace(self, controller=controller)

    def with_effects(self, *effects: Effect) -> "Axis":
        """The axis with these unmodelled effects beside those that it has; an effect replaces one of its name.

        They are no part of its controller's model. Raises `ParameterError` for one that is not registered, for two that
        no machine has beside each other, such as two screws, and for one that contradicts the data sheet.
        """
        names = {effect.name for effect in in_order(effects)}
        require_agreement(effects, self.sheet)
        remaining = [effect for effect in self.drive.effects if effect.name not in names]
        drive = eqx.tree_at(
            lambda d: d.effects,
            self.drive,
            in_order((*remaining, *effects)),
            is_leaf=lambda leaf: isinstance(leaf, tuple),
        )
        return self.with_drive(drive)

    def smooth(self) -> "Axis":
        """The variant whose gradients are useful: no quantiser, rounded limits and switches (`loop.smooth`)."""
        return replace(self, drive=smooth(self.drive), controller=smooth(self.controller))

    def write(self, path: str | Path, comments: tuple[str, ...] = ()) -> None:
        """Write the drive file; raises `DriveFileError` where a file cannot hold this axis."""
        from diffdrive.axis_file.drive_file import write_axis  # which reads axes, too

        write_axis(path, self, comments)

    def __repr__(self) -> str:
        effects = "".join(f", {effect.name}" for effect in self.drive.effects)
        mass = self.drive.plant.mass
        mass_text = f"{float(mass):.4g} kg" if _is_concrete(mass) else f"mass {_described(mass)}"
        return f"Axis({mass_text}, {self.controller.kind or type(self.controller).__name__}, {self.rate:g} Hz{effects})"

    def summary(self) -> str:
        """Every parameter of the machine and every gain, one a line, in SI units."""
        rows = [(path, declared.unit, value) for path, declared, value in quantities(self.drive) if value is not None]
        rows += [(f"controller.{name}", "", gain) for name, gain in self.gains.items()]
        width = max(len(path) for path, *_ in rows)
        return "\n".join(
            [repr(self), *(f"  {path:<{width}}  {_formatted(value)} {unit}" for path, unit, value in rows)]
        )


def require_axis(axis: object, name: str = "axis") -> None:
    """Raise `ParameterError` for what is no axis, such as the path of a drive file."""
    require_a(Axis, name, axis, "read a drive file with read_axis")


def _is_concrete(value: PyTree) -> bool:
    return is_number(value) and not isinstance(value, jax.core.Tracer) and np.ndim(value) == 0


def _described(value: PyTree) -> str:
    """What is no single number, in a word or two."""
    if value is None:
        return "absent"
    if isinstance(value, jax.core.Tracer):
        return "traced"
    return f"of shape {np.shape(value)}" if is_number(value) else "unknown"


def _number_or_pair(value: PyTree) -> PyTree:
    return (value.positive, value.negative) if isinstance(value, Directional) else value


def _formatted(value: PyTree) -> str:
    values = _number_or_pair(value) if isinstance(value, Directional) else (value,)
    texts = dict.fromkeys(f"{float(value):.6g}" if _is_concrete(value) else _described(value) for value in values)
    return " / ".join(texts)


def _unknown(what: str, name: str, known: Mapping[str, object]) -> str:
    return f"no such {what}; {suggestion(name, known)}"
