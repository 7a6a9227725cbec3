"""An example of every figure that the package draws, by the name of the function that draws it.

Small, made up and quick: what is drawn need not be a good machine, but has every kind of thing that the figure shows.
"""

import dataclasses
from functools import cache
from types import SimpleNamespace

import jax
import numpy as np
import pyarrow as pa

import diffdrive as dd
from diffdrive.loop.linearise import OperatingPoint
from diffdrive.loop.run import Run
from diffdrive.model.presets import paper_drive
from experiments.benchmarks import figures as benchmark
from experiments.reports import comparison, encoders, loop_figures, margins, severity, simulation, tuning
from experiments.reports.diagnosis import figures as diagnosis
from experiments.reports.identification import figures as identification
from experiments.reports.identification import forest
from experiments.reports.sweep import figures as sweep
from experiments.studies.emps import study as emps
from experiments.studies.evolution import study as evolution
from experiments.studies.paper import figures as paper
from experiments.studies.paper import headline, scenario
from experiments.studies.recovery import study as recovery
from experiments.studies.tuning_study import study as tuning_study
from tests.support.sound_log import axis_of
from tuning.accuracy.result import SOUND, Accuracy, Without
from tuning.comparison.change import Change
from tuning.comparison.changes import Interval
from tuning.gains.requirements import LoopLimits
from tuning.identification.estimates import EstimateStatus, ParameterEstimate
from tuning.sweeps.sensitivity import Influence
from tuning.sweeps.summary import Group

RANDOM = np.random.default_rng(3)
PAPER_LOADS = (0.0, 2_500.0, 5_000.0, 7_500.0, 10_000.0, 12_600.0)


def rougher(drive, by=1.2):
    """The drive with so much more friction."""
    return dataclasses.replace(drive, friction=jax.tree.map(lambda value: by * value, drive.friction))


def run_of(error=1e-6, *, estimate=0.9, time=None, load=8_000.0):
    """A sine, an error with its sign, friction and their estimates."""
    time = np.linspace(0.0, 2.0, 4_001) if time is None else time
    reference, velocity = 5e-3 * np.sin(3.0 * time), 15e-3 * np.cos(3.0 * time)
    friction = 90.0 * np.sign(velocity)
    table = reference - error * (np.sign(velocity) + 0.3 * np.sin(200.0 * time))
    return Run(
        time=time, reference=reference, reference_velocity=velocity, load=np.full(time.size, load), measured=table,
        table_position=table, velocity=velocity, command=friction + 5.0 * np.sin(300.0 * time), force=friction,
        friction=friction, friction_estimate=estimate * friction,
        load_estimate=load * (estimate - 0.1 + 0.1 * np.sin(20.0 * time)),
    )  # fmt: skip


def a_group(name, scale, diverged=0):
    errors = scale * RANDOM.lognormal(0.0, 0.4, 400)
    lost = np.arange(400) < diverged
    columns = {"peak_m": np.where(lost, np.nan, errors), "diverged": lost, "load": np.linspace(0.0, 12e3, 400)}
    return Group(name, "triangular", pa.table(columns))


GROUPS = [a_group("tuned", 1e-7), a_group("drive", 3e-7, diverged=3)]
INFLUENCES = [
    Influence("friction.coulomb_screw", 0.6, 0.05, 2e-7, 4e-7),
    Influence("plant.mass", 0.1, 0.05, 3.1e-7, 2.9e-7),
    Influence("load", 0.01, 0.05, 2.9e-7, 3e-7),
]


@cache
def loops():
    given = dd.paper_axis("pd+fc+ls")
    tuned = given.with_gains(kp=given.gains["kp"] / 3)
    points = [OperatingPoint(velocity, load) for velocity in (0.0, 1e-3, 2e-2) for load in (0.0, 12_600.0)]
    return {
        name: loop_figures.responses(axis.drive, axis.controller, axis.sampling, points)
        for name, axis in (("given", given), ("tuned", tuned))
    }


def tuning_search():
    history = [(0, k, 0, 1e-2 / (k + 1)) for k in range(5)]
    return SimpleNamespace(best=SimpleNamespace(state=SimpleNamespace(history=history)))


def tuning_runs():
    worse, better = (SimpleNamespace(run=run, rms=run.rms_error()) for run in (run_of(2e-6), run_of(5e-7)))
    return [SimpleNamespace(role="held out", before=worse, after=better, scenario=SimpleNamespace(name="8.4 kN"))]


FRONT = SimpleNamespace(
    points=[
        SimpleNamespace(
            feasible=True, noise_limit=limit, objective=1.0 / limit, command_noise=0.8 * limit, rms=8e-7 / limit
        )
        for limit in (10.0, 20.0, 40.0)
    ]
)


def estimates():
    kinds = (EstimateStatus.FITTED, EstimateStatus.AT_BOUND, EstimateStatus.UNDETERMINED, EstimateStatus.FIXED)
    return [ParameterEstimate(f"plant.{kind.name}", "kg", 100.0, 90.0, 80.0, 95.0, 3.0, 3e3, kind) for kind in kinds]


@cache
def identified():
    """Strokes at several speeds, logged, and a model that is a little off."""
    axis = axis_of()
    pieces = [
        dd.motion.trapezoidal(distance=distance, speed=speed, acceleration=2.0, rate=axis.rate, dwell=0.05)
        for distance, speed in ((2e-3, 5e-3), (8e-3, 2e-2), (2e-2, 8e-2))
    ]
    runs = [dd.simulate(axis, piece) for piece in pieces]
    logs = [run.log(f"lap{k}") for k, run in enumerate(runs)]
    width = max(run.time.size for run in runs)
    padded = lambda rows: np.array([np.pad(row, (0, width - row.size)) for row in rows])  # noqa: E731
    drive = axis_of(mass=98.0).drive
    found = SimpleNamespace(
        drive=drive, velocity=padded([run.velocity for run in runs]),
        missing_force=padded([3.0 * np.sin(900.0 * run.position) for run in runs]),
        innovation=padded([RANDOM.normal(0.0, 3e-8, run.time.size) for run in runs]),
    )  # fmt: skip
    return found, rougher(axis_of().drive), logs


def diagnosed():
    """A nominal model, one recalibrated and one with cogging, of two lanes of one log."""
    count, rate = 2_000, 1_000.0
    position = 0.01 * np.sin(np.arange(count) / 200.0)
    models = []
    for name, size in (("nominal", 3.0), ("recalibrated", 2.5), ("+ cogging", 0.3)):
        force = SimpleNamespace(
            is_known=True,
            rms=size,
            counts=np.ones((2, count)),
            trajectory=SimpleNamespace(position=[position, position]),
            force=size * RANDOM.normal(size=(2, count)),
        )  # fmt: skip
        loop = SimpleNamespace(
            says="", position_rms=1e-7 * size, position_floor=1e-8, command_rms=size, command_floor=0.4
        )
        models.append(SimpleNamespace(name=name, force=force, interval=(0.9 * size, 1.1 * size), loop=loop))
    cogging = SimpleNamespace(candidate=SimpleNamespace(effect=SimpleNamespace(name="cogging")))
    model = SimpleNamespace(members=[cogging], added=1, values=lambda theta: [{"period": [2.5e-3]}])
    regions = [
        SimpleNamespace(dimension="speed", region=f"{k} to {k + 1} mm/s", share=0.5 / k, expected=0.2, p_value=1e-4)
        for k in (1, 2, 3)
    ]
    beliefs = [
        SimpleNamespace(effect=name, confidence=sure, found=sure > 0.5, round=0)
        for name, sure in (("cogging", 0.97), ("backlash", 0.02))
    ]
    return SimpleNamespace(
        comparisons=models, floor=0.28, split=SimpleNamespace(says="the last 40 % held out", logs=[0]),
        logged=SimpleNamespace(owner=[0, 0], sampling=SimpleNamespace(rate=rate), starts=[0.0, 2.5]),
        found=SimpleNamespace(model=model, theta=None), where=regions, verdict=SimpleNamespace(beliefs=beliefs),
    )  # fmt: skip


def severe():
    judged = [Accuracy(scale * 8e-6, 5e-6, 2e-6, 4e-6, scale * 6e-6, 1e-6) for scale in (1.0, 0.4, 0.2)]
    without = [Without("backlash", ("screw",), judged[1]), Without(SOUND, (), judged[2])]
    return SimpleNamespace(unit=("µm", 1e6), as_it_is=judged[0], without=without, by_gain=without[:1], tolerance=5e-6)


def changes():
    return [
        Change("plant.mass", "mass", "kg", 100.0, 110.0, Interval(0.1, 0.08, 0.12), True, True, 0.03),
        Change("friction.viscous", "friction", "N*s/m", 1e3, 1e3, Interval(0.01, -0.02, 0.04), True, False, 0.05),
        Change(
            "encoders.reversal_error", "reversal error", "m", 1e-6, 3e-6, Interval(2e-6, 1e-6, 3e-6), False, True, 5e-7
        ),
    ]


def compared():
    axis = dd.paper_axis("pd+fc+ls")
    loop = dd.linearise(axis, velocity=0.01)
    frequency = np.geomspace(5.0, 2_000.0, 300)
    model = loop.response(frequency)
    measured = model * (1.5 + 0.3j * frequency / 2_000.0)
    response = SimpleNamespace(coherence=np.linspace(1.0, 0.6, 300), frequency=frequency)
    return SimpleNamespace(
        measured=response, frequency=frequency, loop=measured, model_loop=model, margins=loop.margins(),
        model_margins=loop.margins(), departure=np.abs(measured - model) / np.abs(1.0 + model),
        largest_departure=(0.6, 1_200.0),
    )  # fmt: skip


def two_encoders():
    time = np.linspace(0.0, 4.0, 4_000)
    position, direction = 0.02 * np.sin(2.0 * time), np.sign(np.cos(2.0 * time))
    fitted = 2e-6 * direction
    samples = SimpleNamespace(
        time=time,
        position=position,
        direction=direction,
        fitted=fitted,
        difference=fitted + RANDOM.normal(0, 3e-7, 4_000),
    )
    error = SimpleNamespace(value=4e-6, half_width=5e-7)
    return SimpleNamespace(
        log="lap", samples=samples,
        headline=lambda: "reversal error 4 um (3.5 to 4.5 um)", places=[(-0.01, 0.0, error)],
        reversals=[SimpleNamespace(position=place, error=4e-6) for place in (-0.02, 0.02)],
    )  # fmt: skip


def paper_runs(names):
    time = np.linspace(0.0, 8.0, 16_001)
    return {name: run_of(1e-5 / 4.0**k, time=time, estimate=0.7 + 0.08 * k) for k, name in enumerate(names)}


def a_scenario():
    time = np.linspace(0.0, 8.0, 16_001)
    ramp = 1e4 * np.clip(time - 2.5, 0.0, 1.0)
    lap = SimpleNamespace(time=time, position=5e-3 * np.sin(3 * time), velocity=15e-3 * np.cos(3 * time))
    return SimpleNamespace(motion=lap, load=ramp)


def friction_curves():
    speeds = np.concatenate([-np.geomspace(0.05, 1e-5, 50), np.geomspace(1e-5, 0.05, 50)])
    shape = np.sign(speeds) * (20.0 + 20.0 * np.exp(-np.abs(speeds) / 1e-3) + 1e3 * np.abs(speeds))
    stribeck = {load: shape + np.sign(speeds) * 3.66e-4 * load for load in PAPER_LOADS}
    turn = np.linspace(0.0, 2.0 * np.pi, 200)
    loop = {load: (2e-5 * np.sin(turn), (30.0 + 3.66e-4 * load) * np.tanh(3.0 * np.cos(turn))) for load in PAPER_LOADS}
    return speeds, stribeck, loop


def friction_rows():
    return np.array([[load, 63.4, 5.5 + 3.66e-4 * load, 65.0, 5.5 + 3.66e-4 * load] for load in PAPER_LOADS])


def emps_replays():
    time = np.linspace(0.0, 1.0, 500)
    return {
        name: SimpleNamespace(time=time, command=50.0 * np.sin(9 * time), command_error=size * np.sin(50 * time))
        for name, size in (("published", 5.0), ("identified", 1.0))
    }


def emps_record():
    time = np.linspace(0.0, 1.0, 500)
    return SimpleNamespace(log=SimpleNamespace(time=time, command=52.0 * np.sin(9 * time)))


def measured_curve():
    velocity = np.array([-0.1, -0.05, 0.05, 0.1])
    return SimpleNamespace(
        curves=[SimpleNamespace(velocity=velocity, friction=90.0 * np.sign(velocity), standard_error=np.full(4, 2.0))]
    )


def draws():
    rows = [
        {"name": name, "status": "fitted", "value": 1.0 + 0.1 * k, "true": 1.1, "low": 0.9, "high": 1.3 + 0.1 * k}
        for k in range(3)
        for name in ("mass", "viscous.positive")
    ]
    return [{"rows": rows}]


def baselines(cost):
    history = [SimpleNamespace(simulations=10 * k, seconds=0.5 * k, feasible=cost / k) for k in range(1, 6)]
    return [SimpleNamespace(history=history)]


RATES = {"columns": ["what", "ns", "x the plain loop"], "rows": [["pd", 100.0, 1.0], ["pd+fc", 150.0, 1.5]]}
TABLES = {"lanes": {"columns": ["lanes", "ns"], "rows": [[1, 100.0], [64, 20.0]]}, "controllers": RATES}

EXAMPLES = {
    simulation.run_figure: lambda: simulation.run_figure(run_of(), 0.1),
    loop_figures.nyquist: lambda: loop_figures.nyquist(loops(), LoopLimits(sensitivity=2.0)),
    loop_figures.bode: lambda: loop_figures.bode(loops()),
    tuning.tuning_figure: lambda: tuning.tuning_figure(tuning_search(), tuning_runs(), SimpleNamespace(settle=0.4)),
    tuning.pareto_figure: lambda: tuning.pareto_figure(FRONT),
    sweep.distribution: lambda: sweep.distribution(GROUPS, 2e-7, "peak"),
    sweep.exceedance_figure: lambda: sweep.exceedance_figure(GROUPS, 2e-7, "peak"),
    sweep.error_against: lambda: sweep.error_against(GROUPS, "load", "N", 2e-7, "peak"),
    sweep.tornado: lambda: sweep.tornado(INFLUENCES, GROUPS[1], "peak"),
    forest.forest: lambda: forest.forest(estimates()),
    identification._stribeck: lambda: identification._stribeck(*identified())[0],
    identification._hysteresis: lambda: identification._hysteresis(*identified())[0],
    identification._missing_force: lambda: identification._missing_force(*identified()[::2]),
    identification._innovations: lambda: identification._innovations(*identified()[::2]),
    diagnosis._ladder: lambda: diagnosis._ladder(diagnosed()),
    diagnosis._missing: lambda: diagnosis._missing(diagnosed(), [SimpleNamespace(name="lap")]),
    diagnosis._where: lambda: diagnosis._where(diagnosed()),
    diagnosis._causes: lambda: diagnosis._causes(diagnosed()),
    severity.severity_figure: lambda: severity.severity_figure(severe()),
    comparison.changes_figure: lambda: comparison.changes_figure(changes()),
    margins.comparison_figure: lambda: margins.comparison_figure(compared()),
    encoders.encoders_figure: lambda: encoders.encoders_figure(two_encoders()),
    benchmark.bench_figure: lambda: benchmark.bench_figure(TABLES),
    paper.figure_4: lambda: paper.figure_4(friction_rows()),
    paper.figure_5: lambda: paper.figure_5(*friction_curves()),
    paper.figure_7: lambda: paper.figure_7(a_scenario(), paper_runs([kind.upper() for kind in scenario.KINDS])),
    paper.figure_8: lambda: paper.figure_8(*(one[0.0] if isinstance(one, dict) else one for one in friction_curves())),
    paper.figure_9: lambda: paper.figure_9(paper_runs(("DOBVSC", "PD+FF+DOB", "PD+FC"))),
    paper.figure_10: lambda: paper.figure_10(
        {load: paper_runs(("PD+FC", "PD+FC+LE", "PD+FC+LS")) for load in scenario.TABLE_4}
    ),
    headline.headline_figure: lambda: headline.headline_figure(a_scenario(), paper_runs(headline.KINDS)),
    emps.emps_figure: lambda: emps.emps_figure(emps_record(), emps_replays()),
    emps.emps_friction_figure: lambda: emps.emps_friction_figure(
        measured_curve(), {"published": paper_drive(), "identified": rougher(paper_drive())}, 0.0
    ),
    evolution.evolution_figure: lambda: evolution.evolution_figure(
        {name: [[(10 * k, 0.1 * k, size / k) for k in range(1, 5)]] for name, size in (("one", 1.0), ("other", 2.0))},
        0.25,
    ),
    recovery.recovery_figure: lambda: recovery.recovery_figure(draws()),
    tuning_study.race_figure: lambda: tuning_study.race_figure(
        [(10 * k, k, 0.1 * k, 1.0 / k) for k in range(1, 6)], {"CMA-ES": baselines(2.0), "Nelder-Mead": baselines(3.0)}
    ),
    tuning_study.parameters_figure: lambda: tuning_study.parameters_figure(
        [[count, 1.0, 1.1, 10 * count, 0.1 * count, 30 * count, None] for count in (2, 4, 7)]
    ),
}  # fmt: skip
