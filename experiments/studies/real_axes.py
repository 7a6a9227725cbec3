"""`diffdrive real-axes`: the diagnosis on measured axes, a known term withheld from the model.

EMPS: the drive is identified from the estimation file, one of its terms is then left out, and the diagnosis is given
the rest as the nominal drive. What it finds is judged on the pulse file, session parameters registered on that file's
first seconds. Then the identified drive unchanged: which effects does it lack?

LAAS: a motor with strong cogging, the compensation of which is off for half of each log and on for the other half: is
the same cogging found in both from the current command of the velocity loop?
"""

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from diffdrive.controllers import Controller, UnknownController
from diffdrive.errors import ParameterError
from diffdrive.logs import Log
from diffdrive.model.parameters import Actuator, Drive
from diffdrive.model.quantity import Directional
from experiments.reports.report import Report
from experiments.studies import laas
from experiments.studies.emps import axis as emps
from experiments.studies.emps.study import Records, identify_axis
from experiments.studies.force_error import force_error
from experiments.studies.registration import registered
from tuning.diagnosis.as_json import cause
from tuning.diagnosis.cause_words import numbers
from tuning.diagnosis.diagnose import Diagnosis, diagnose
from tuning.diagnosis.workflow import augmented_drive
from tuning.identification.inverse_dynamics import DYNAMICS
from tuning.store.folder import FolderStore

PARTS = "real-axes.parts"  # finished searches, from which the same command continues
PUBLISHED_TOLERANCE = 0.02  # tolerance of a published model's parameters
IDENTIFIED_TOLERANCE = 0.005  # of a drive that was identified from the same log
GUESSED_TOLERANCE = 0.2  # of one whose presliding friction is unknown
GAIN_FACTOR = 1.2  # of the logged command over the true one
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
    mean = 0.5 * (pair.positive + pair.negative)
    return Directional(mean, mean)


def _symmetric(drive: Drive) -> Drive:
    """The drive with equal directions; the difference of the Coulomb friction becomes a constant force."""
    plant, friction = drive.plant, drive.friction
    offset = 0.5 * (friction.coulomb_screw.negative - friction.coulomb_screw.positive)
    pairs: dict[str, Any] = {
        name: _mean(getattr(friction, name)) for name in ("coulomb_screw", "breakaway_gap", "viscous")
    }
    return dataclasses.replace(
        drive,
        plant=dataclasses.replace(plant, constant_force=plant.constant_force + offset, damping=_mean(plant.damping)),
        friction=dataclasses.replace(friction, **pairs),
    )


def withheld_terms(drive: Drive) -> dict[str, WithheldTerm]:
    """What is withheld, one at a time: from the benchmark's own model its terms, from the identified drive the rest."""
    published, actuator, symmetric = emps.reference_drive(), drive.actuator, _symmetric(drive)
    without_coulomb = dataclasses.replace(published.friction, coulomb_screw=ZERO)
    without_viscous = dataclasses.replace(published.friction, viscous=ZERO)
    without_offset = dataclasses.replace(published.plant, constant_force=0.0)
    offset_plant = dataclasses.replace(symmetric.plant, constant_force=drive.plant.constant_force)
    delayed = Actuator(
        actuator.force_limit, actuator.limit_rounding, actuator.delay_samples + 1, actuator.delay_fraction
    )
    shape, offset = ("friction_shape",), ("constant_force", "friction_asymmetry")
    return {
        "nothing": WithheldTerm(
            published, published, ("cogging",), PUBLISHED_TOLERANCE
        ),  # what the others are to be held against
        "coulomb": WithheldTerm(
            published, dataclasses.replace(published, friction=without_coulomb), shape, PUBLISHED_TOLERANCE
        ),
        "viscous": WithheldTerm(
            published, dataclasses.replace(published, friction=without_viscous), shape, PUBLISHED_TOLERANCE
        ),
        "offset": WithheldTerm(
            published, dataclasses.replace(published, plant=without_offset), offset, PUBLISHED_TOLERANCE
        ),
        "delay": WithheldTerm(
            drive, dataclasses.replace(drive, actuator=delayed), ("loop_delay",), IDENTIFIED_TOLERANCE
        ),
        "gain": WithheldTerm(drive, drive, ("force_gain",), IDENTIFIED_TOLERANCE, GAIN_FACTOR),
        "asymmetry": WithheldTerm(
            drive, dataclasses.replace(symmetric, plant=offset_plant), offset[::-1], IDENTIFIED_TOLERANCE
        ),
    }


def real_axes(report: Report, which: str = "all", terms: Sequence[str] = ()) -> None:
    """Every part for which the data are there; `which` is "emps", "laas" or "all".

    `terms` are those of `withheld_terms` that are withheld from EMPS, or `UNCHANGED`; all by default. Raises
    `ParameterError` where there are no data, and for an axis or a term that is not known.
    """
    parts: dict[str, tuple[Path | None, Callable[[Report, Path], None]]] = {
        "emps": (emps.find_folder(), lambda report, folder: _emps(report, folder, terms)),
        "laas": (laas.find_folder(), _laas),
    }
    if which != "all" and which not in parts:
        raise ParameterError(f"--axis {which}: no such axis; known: all, {', '.join(parts)}")
    if terms and which != "emps":
        raise ParameterError("--term is of the EMPS axis: give --axis emps beside it")
    known = [*withheld_terms(emps.reference_drive()), UNCHANGED]
    for term in terms:
        if term not in known:
            raise ParameterError(f"--term {term}: no such term; known: {', '.join(known)}")
    selected = {name: part for name, part in parts.items() if which in ("all", name)}
    available = {name: part for name, part in selected.items() if part[0] is not None}
    if not available:
        raise ParameterError(f"no data of {', '.join(selected)} in shared/data beside this folder or the checkout")
    for name, (folder, study) in selected.items():
        if folder is None:
            report.say(f"{name}: left out, its data are not there")
        else:
            study(report, folder)
    if store := FolderStore.in_folder(report.out, PARTS):
        store.remove()


def _diagnose(
    report: Report, drive: Drive, controller: Controller, log: Log, max_effects: int, tolerance: float
) -> Diagnosis:
    parts = FolderStore.in_folder(report.out, PARTS)
    with report.stages() as progress:
        return diagnose(
            drive, controller, [log], tolerance=tolerance, most_effects=max_effects, store=parts, progress=progress
        )


def _emps(report: Report, folder: Path, terms: Sequence[str]) -> None:
    records = emps.read_all(folder)
    drive = identify_axis(report, records, store=FolderStore.in_folder(report.out, PARTS)).drive
    controller = emps.controller(records["estimation"])
    cases = {term: case for term, case in withheld_terms(drive).items() if term in terms or not terms}
    if cases:
        _emps_withheld(report, records, cases, controller)
    if UNCHANGED in terms or not terms:
        _emps_unchanged(report, records, drive, controller)


def _emps_withheld(report: Report, records: Records, cases: dict[str, WithheldTerm], controller: Controller) -> None:
    """Each term withheld: is it named, and does adding it close the gap on the other file?"""
    rows: list[list[object]] = []
    try:
        for term, case in cases.items():
            rows.append(_withheld_row(report, records, term, case, controller))
    finally:  # each row takes minutes: the finished ones are reported
        report.table(
            "emps_withheld",
            ("withheld", "verdict", "found", "rivals of first", "named", "full model %", "without %", "with it %"),
            rows,
            "EMPS, a term withheld: found from the estimation file, force error on the pulse file",
        )
    known = [row for row in rows if row[0] != "nothing"]  # which withholds nothing
    if known:
        named = sum(row[4] != "not" for row in known)
        report.result(f"EMPS: {named} of {len(known)} terms are named, each withheld by itself.")


def _withheld_row(
    report: Report, records: Records, term: str, case: WithheldTerm, controller: Controller
) -> list[object]:
    estimation, pulses = (_scaled(records[name].log, case.force) for name in ("estimation", "pulses"))
    diagnosis = _diagnose(report, case.nominal, controller, estimation, 2, case.tolerance)
    report.say(f"EMPS without its {term}: {diagnosis.verdict.says}")
    real = records["pulses"].log
    full = force_error(registered(case.full, real), real)
    without, added = (
        force_error(registered(drive, pulses), pulses, DYNAMICS, real)
        for drive in (case.nominal, augmented_drive(diagnosis))
    )
    causes = [belief for belief in diagnosis.verdict.beliefs if belief.found]
    effects, rivals = (
        [belief.effect for belief in causes],
        [name for belief in causes[:1] for name in belief.alternatives],
    )
    named = _how_named(case.names, effects, rivals)
    return [term, diagnosis.verdict.verdict, " + ".join(effects), " ".join(rivals), named, full, without, added]


def _how_named(names: Sequence[str], effects: Sequence[str], rivals: Sequence[str]) -> str:
    """How the withheld term is named: the axis lacks other effects, too, and one of them may come first."""
    if set(effects[:1]) & set(names):
        return "first"
    if set(rivals) & set(names):
        return "as a rival"
    return "beside another" if set(effects) & set(names) else "not"


def _scaled(log: Log, factor: float) -> Log:
    return dataclasses.replace(log, command=factor * log.command)


def _emps_unchanged(report: Report, records: Records, drive: Drive, controller: Controller) -> None:
    """What the identified drive lacks, found in one file and checked on the other."""
    diagnosis = _diagnose(report, drive, controller, records["estimation"].log, 2, IDENTIFIED_TOLERANCE)
    report.result(f"EMPS as it is: {diagnosis.verdict.verdict}: {diagnosis.verdict.says}")
    report.table(
        "emps_causes", ("effect", "confidence", "evidence", "parameters"), _causes(diagnosis), "EMPS: what is missing"
    )
    log = records["pulses"].log
    candidates = {"identified": drive, "with what was found": augmented_drive(diagnosis)}
    errors = [force_error(registered(candidate, log), log) for candidate in candidates.values()]
    rows = [
        [name, force_error(candidate, log), error]
        for (name, candidate), error in zip(candidates.items(), errors, strict=True)
    ]
    report.table(
        "emps_pulses", ("drive", "as it is %", "registered %"), rows,
        f"EMPS, force error on the pulse file (benchmark {PUBLISHED_ERROR} %, bar {ERROR_BAR} %)",
    )  # fmt: skip
    report.values("emps_bar", percent=ERROR_BAR, met=errors[-1] <= ERROR_BAR)


def _laas(report: Report, folder: Path) -> None:
    rows: list[list[object]] = []
    nominal = laas.nominal_drive(folder)
    try:
        for file in laas.ACTIVE_FLAGS:
            for part, log in laas.read(folder / file).items():
                diagnosis = _diagnose(report, nominal, UnknownController(), log, 2, GUESSED_TOLERANCE)
                report.say(f"{log.name}: {diagnosis.verdict.says}")
                closed_percent = None if diagnosis.closed is None else 100 * diagnosis.closed.share
                rows.append(
                    [file, part, diagnosis.verdict.verdict, *_cogging(diagnosis), closed_percent, _others(diagnosis)]
                )
    finally:
        report.table(
            "laas_cogging",
            ("log", "compensation", "verdict", "cogging, mA", "waves a turn", "held-out gap closed, %", "others found"),
            rows,
            "LAAS: the strongest wave of the cogging that was found",
        )
    found = sum(row[3] is not None for row in rows)
    report.result(f"LAAS: cogging is found in {found} of {len(rows)} halves of logs.")


def _cogging(diagnosis: Diagnosis) -> tuple[float | None, float | None]:
    """Amplitude (mA) and number of waves a turn of the strongest harmonic, None where no cogging was found."""
    for effect in augmented_drive(diagnosis).effects:
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


def _others(diagnosis: Diagnosis) -> str:
    return " + ".join(
        belief.effect for belief in diagnosis.verdict.beliefs if belief.found and belief.effect != "cogging"
    )


def _causes(diagnosis: Diagnosis) -> list[list[object]]:
    rows = []
    for belief in diagnosis.verdict.beliefs:
        details = cause(diagnosis, belief)
        text = "; ".join(numbers(details)) if belief.found else ""
        rows.append([belief.effect, round(belief.confidence, 3), round(belief.gain), text])
    return rows
