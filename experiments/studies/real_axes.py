"""`diffdrive real-axes`: the diagnosis on measured axes, a known term withheld from the model.

EMPS: the drive is identified from the estimation file, one of its terms is then left out, and the diagnosis is given
the rest as the nominal drive. What it finds is judged on the pulse file, session parameters registered on that file's
first seconds. Then the identified drive as it is: what does it lack?

LAAS: a motor with strong cogging, the compensation of which is off for half of each log and on for the other half: is
the same cogging found in both from the current that the velocity loop asks for?
"""

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from diffdrive.controllers import Controller, UnknownController
from diffdrive.errors import ParameterError
from diffdrive.logs import Log
from diffdrive.model.parameters import Actuator, Directional, Drive
from experiments.reports.diagnosis.diagnosis import augmented_drive
from experiments.reports.report import Report
from experiments.studies import laas
from experiments.studies.emps import axis as emps
from experiments.studies.emps.study import Records, identify_axis
from tuning.diagnosis.as_json import cause
from tuning.diagnosis.cause_words import numbers
from tuning.diagnosis.diagnose import Diagnosis, diagnose
from tuning.diagnosis.inverse import force_error
from tuning.diagnosis.registration import registered
from tuning.identification.inverse_dynamics import DYNAMICS
from tuning.store.folder import FolderStore

PARTS = "real-axes.parts"  # finished searches, from which the same command continues
PUBLISHED_TOLERANCE = 0.02  # tolerance of a published model's parameters
IDENTIFIED_TOLERANCE = 0.005  # of a drive that was identified from the same log
GUESSED_TOLERANCE = 0.2  # of one whose friction below sliding nobody knows
GAIN_FACTOR = 1.2  # of the force that the command is said to be
ZERO = Directional(0.0, 0.0)
UNCHANGED = "none"  # the term that is withheld from the identified drive as it is
PUBLISHED_ERROR = 5.982  # %, of the benchmark's own model on the pulse file
ERROR_BAR = 3.0  # %, for what the diagnosis makes of it


class WithheldTerm(NamedTuple):
    """A model, what it is without one of its terms, and the names by which that term may be found."""

    full: Drive
    nominal: Drive
    names: tuple[str, ...]
    tolerance: float
    force: float = 1.0  # factor on the logged command


def _mean(pair: Directional) -> Directional:
    middle = 0.5 * (pair.positive + pair.negative)
    return Directional(middle, middle)


def _symmetric(drive: Drive) -> Drive:
    """Both directions alike; what the Coulomb friction differs by is a constant force, the rest is left out."""
    plant, friction = drive.plant, drive.friction
    tilt = 0.5 * (friction.coulomb_screw.negative - friction.coulomb_screw.positive)
    pairs = {name: _mean(getattr(friction, name)) for name in ("coulomb_screw", "breakaway_gap", "viscous")}
    return dataclasses.replace(
        drive,
        plant=dataclasses.replace(plant, constant_force=plant.constant_force + tilt, damping=_mean(plant.damping)),
        friction=dataclasses.replace(friction, **pairs),
    )


def withheld_terms(drive: Drive) -> dict[str, WithheldTerm]:
    """What is withheld, one at a time: from the benchmark's own model its terms, from the identified drive the rest."""
    published, actuator, even = emps.reference_drive(), drive.actuator, _symmetric(drive)
    slippery = dataclasses.replace(published.friction, coulomb_screw=ZERO)
    inviscid = dataclasses.replace(published.friction, viscous=ZERO)
    level = dataclasses.replace(published.plant, constant_force=0.0)
    tilted = dataclasses.replace(even.plant, constant_force=drive.plant.constant_force)
    late = Actuator(actuator.force_limit, actuator.limit_rounding, actuator.delay_samples + 1, actuator.delay_fraction)
    shape, tilt = ("friction_shape",), ("constant_force", "friction_asymmetry")
    return {
        "nothing": WithheldTerm(
            published, published, ("cogging",), PUBLISHED_TOLERANCE
        ),  # what the others are to be held against
        "coulomb": WithheldTerm(
            published, dataclasses.replace(published, friction=slippery), shape, PUBLISHED_TOLERANCE
        ),
        "viscous": WithheldTerm(
            published, dataclasses.replace(published, friction=inviscid), shape, PUBLISHED_TOLERANCE
        ),
        "offset": WithheldTerm(published, dataclasses.replace(published, plant=level), tilt, PUBLISHED_TOLERANCE),
        "delay": WithheldTerm(drive, dataclasses.replace(drive, actuator=late), ("loop_delay",), IDENTIFIED_TOLERANCE),
        "gain": WithheldTerm(drive, drive, ("force_gain",), IDENTIFIED_TOLERANCE, GAIN_FACTOR),
        "asymmetry": WithheldTerm(drive, dataclasses.replace(even, plant=tilted), tilt[::-1], IDENTIFIED_TOLERANCE),
    }


def real_axes(report: Report, which: str = "all", wanted_terms: Sequence[str] = ()) -> None:
    """Every part for which the data are there; `which` is "emps", "laas" or "all".

    `wanted_terms` are those of `withheld_terms` that are withheld from EMPS, or `UNCHANGED`; all by default. Raises
    `ParameterError` where there are no data, and for an axis or a term that is not known.
    """
    parts: dict[str, tuple[Path | None, Callable[[Report, Path], None]]] = {
        "emps": (emps.find_folder(), lambda report, folder: _emps(report, folder, wanted_terms)),
        "laas": (laas.find_folder(), _laas),
    }
    if which != "all" and which not in parts:
        raise ParameterError(f"--axis {which}: no such axis; known: all, {', '.join(parts)}")
    if wanted_terms and which != "emps":
        raise ParameterError("--term is of the EMPS axis: give --axis emps beside it")
    known = [*withheld_terms(emps.reference_drive()), UNCHANGED]
    for term in wanted_terms:
        if term not in known:
            raise ParameterError(f"--term {term}: no such term; known: {', '.join(known)}")
    wanted = {name: part for name, part in parts.items() if which in ("all", name)}
    there = {name: part for name, part in wanted.items() if part[0] is not None}
    if not there:
        raise ParameterError(f"no data of {', '.join(wanted)} in shared/data beside this folder or the checkout")
    for name, (folder, study) in wanted.items():
        if folder is None:
            report.say(f"{name}: left out, its data are not there")
        else:
            study(report, folder)
    if parts := FolderStore.within(report.out, PARTS):
        parts.remove()


def _diagnose(report: Report, drive: Drive, controller: Controller, log: Log, most: int, tolerance: float) -> Diagnosis:
    parts = FolderStore.within(report.out, PARTS)
    with report.stages() as progress:
        return diagnose(
            drive, controller, [log], tolerance=tolerance, most_effects=most, store=parts, progress=progress
        )


def _emps(report: Report, folder: Path, wanted_terms: Sequence[str]) -> None:
    records = emps.read_all(folder)
    drive = identify_axis(report, records, store=FolderStore.within(report.out, PARTS)).drive
    controller = emps.controller(records["estimation"])
    cases = {term: case for term, case in withheld_terms(drive).items() if term in wanted_terms or not wanted_terms}
    if cases:
        _emps_withheld(report, records, cases, controller)
    if UNCHANGED in wanted_terms or not wanted_terms:
        _emps_unchanged(report, records, drive, controller)


def _emps_withheld(report: Report, records: Records, cases: dict[str, WithheldTerm], controller: Controller) -> None:
    """Each term withheld: is it named, and does adding it close the gap on the other file?"""
    rows: list[list[Any]] = []
    try:
        for term, case in cases.items():
            rows.append(_withheld_row(report, records, term, case, controller))
    finally:  # each row takes minutes: what is there is kept
        report.table(
            "emps_withheld",
            ("withheld", "verdict", "found", "rivals of first", "named", "full model %", "without %", "with it %"),
            rows,
            "EMPS, a term withheld: found from the estimation file, force error on the pulse file",
        )


def _withheld_row(report: Report, records: Records, term: str, case: WithheldTerm, controller: Controller) -> list[Any]:
    estimation, pulses = (_scaled(records[name].log, case.force) for name in ("estimation", "pulses"))
    report.say(f"EMPS without its {term}:")
    found = _diagnose(report, case.nominal, controller, estimation, 2, case.tolerance)
    real = records["pulses"].log
    full = force_error(registered(case.full, real), real)
    without, added = (
        force_error(registered(one, pulses), pulses, DYNAMICS, real) for one in (case.nominal, augmented_drive(found))
    )
    causes = [one for one in found.verdict.beliefs if one.found]
    effects, rivals = [one.effect for one in causes], [name for one in causes[:1] for name in one.alternatives]
    named = _how_named(case.names, effects, rivals)
    return [term, found.verdict.verdict, " + ".join(effects), " ".join(rivals), named, full, without, added]


def _how_named(right: Sequence[str], effects: Sequence[str], rivals: Sequence[str]) -> str:
    """How what was withheld is named: the axis lacks other things beside it, and one of them may come first."""
    if set(effects[:1]) & set(right):
        return "first"
    if set(rivals) & set(right):
        return "as a rival"
    return "beside another" if set(effects) & set(right) else "not"


def _scaled(log: Log, factor: float) -> Log:
    return dataclasses.replace(log, command=factor * log.command)


def _emps_unchanged(report: Report, records: Records, drive: Drive, controller: Controller) -> None:
    """What the identified drive lacks, found in one file and checked on the other."""
    found = _diagnose(report, drive, controller, records["estimation"].log, 2, IDENTIFIED_TOLERANCE)
    report.say(f"EMPS as it is: {found.verdict.verdict}: {found.verdict.says}")
    report.table(
        "emps_causes", ("effect", "confidence", "evidence", "parameters"), _causes(found), "EMPS: what it lacks"
    )
    log = records["pulses"].log
    rows = [
        [name, force_error(one, log), force_error(registered(one, log), log)]
        for name, one in (("identified", drive), ("with what was found", augmented_drive(found)))
    ]
    report.table(
        "emps_pulses", ("drive", "as it is %", "registered %"), rows,
        f"EMPS, force error on the pulse file (benchmark {PUBLISHED_ERROR} %, bar {ERROR_BAR} %)",
    )  # fmt: skip
    report.values("emps_bar", percent=ERROR_BAR, met=rows[-1][-1] <= ERROR_BAR)


def _laas(report: Report, folder: Path) -> None:
    rows: list[list[Any]] = []
    nominal = laas.nominal_drive(folder)
    try:
        for file in laas.ACTIVE_FLAGS:
            for part, log in laas.read(folder / file).items():
                report.say(f"{log.name}:")
                found = _diagnose(report, nominal, UnknownController(), log, 2, GUESSED_TOLERANCE)
                report.say(found.verdict.says)
                shut = None if found.closed is None else 100 * found.closed.share
                rows.append([file, part, found.verdict.verdict, *_cogging(found), shut, _others(found)])
    finally:
        report.table(
            "laas_cogging",
            ("log", "compensation", "verdict", "cogging, mA", "waves a turn", "held-out gap closed, %", "others found"),
            rows,
            "LAAS: the strongest wave of the cogging that was found",
        )


def _cogging(found: Diagnosis) -> tuple[float | None, float | None]:
    """Amplitude (mA) and number of waves a turn of the strongest harmonic, None where no cogging was found."""
    for effect in augmented_drive(found).effects:
        if effect.name == "cogging":
            waves = {
                1: (effect.cosine, effect.sine),
                2: (effect.cosine2, effect.sine2),
                6: (effect.cosine6, effect.sine6),
            }
            sizes = {order: (float(a) ** 2 + float(b) ** 2) ** 0.5 for order, (a, b) in waves.items()}
            strongest = max(sizes, key=lambda order: sizes[order])
            return 1e3 * sizes[strongest] / laas.NEWTONS_PER_AMPERE, strongest * laas.LEAD / float(effect.period)
    return None, None


def _others(found: Diagnosis) -> str:
    return " + ".join(one.effect for one in found.verdict.beliefs if one.found and one.effect != "cogging")


def _causes(found: Diagnosis) -> list[list[Any]]:
    rows = []
    for one in found.verdict.beliefs:
        told = cause(found, one)
        shown = "; ".join(numbers(told)) if one.found else ""
        rows.append([one.effect, round(one.confidence, 3), round(one.gain), shown])
    return rows
