# %% [markdown]
# # Identify and diagnose
#
# A machine does not do what its data sheet says. Which numbers of the model are wrong? `identify` answers that. What
# does the machine do that the model leaves out? `diagnose` answers that. The machine here is simulated, so that you
# know the truth.

# %%
import matplotlib.pyplot as plt
import numpy as np

import diffdrive as dd
import tuning

dd.configure()

# %% [markdown]
# ## A data sheet and a machine
#
# The data sheet is the axis: 100 kg under PD control with feed-forward at 10 kHz, a scale with counts of 0.1 um and 30
# nm of noise. (`dd.read_axis("drive.toml")` reads yours.) The machine as built is 8 kg heavier, with more Coulomb and
# less viscous friction. `identify` and `diagnose` know it by its logs alone.

# %%
data_sheet = dd.paper_axis("pd").replace({"sensor.noise": 30e-9})
as_built = data_sheet.replace(
    {
        "plant.mass": 108.0,
        "friction.coulomb_screw": (70.0, 72.0),  # in the positive and in the negative direction
        "friction.viscous": (1_700.0, 1_550.0),
    }
)


def to_and_fro(speed, stroke):
    """Two seconds at this speed (m/s) over this stroke (m)."""
    return dd.motion.triangular(speed=speed, stroke=stroke, rounding=0.1, duration=2.0, rate=data_sheet.rate)


def log_of(axis, machine, motion, name, seed):
    """What a machine logs under an axis's controller: time, reference, position, command."""
    return dd.simulate(axis, motion, machine=machine, seed=seed).log(name)


commissioning = [
    log_of(data_sheet, as_built, to_and_fro(speed=0.030, stroke=0.012), "fast", seed=1),
    log_of(data_sheet, as_built, to_and_fro(speed=0.003, stroke=0.001), "slow", seed=2),
]
for log in commissioning:
    print(log)

# %% [markdown]
# ## Identify
#
# Two speeds tell Coulomb from viscous friction, and the reversals tell the mass. Both logs hold one load, so the
# coefficient of the load stays as it is (`fixed`). One start of the search (`starts`) is enough near the data sheet;
# leave it out for your own machine.

# %%
fit = tuning.identify(data_sheet, commissioning, fixed=["load_coefficient"], starts=1)
fit

# %% [markdown]
# Each parameter comes with its 95 % interval. The data sheet is off by 7 to 10 %, and the intervals hold the truth:

# %%
coulomb, viscous = as_built.value("friction.coulomb_screw"), as_built.value("friction.viscous")
truth = {
    "mass": as_built.value("plant.mass"),
    "coulomb_screw.positive": coulomb[0],
    "coulomb_screw.negative": coulomb[1],
    "viscous.positive": viscous[0],
    "viscous.negative": viscous[1],
}
print(f"{'':24}{'data sheet':>10}{'identified':>12}{'true':>8}  unit    95 % interval")
for name, true in truth.items():
    one = fit.estimate(name)
    low, high = fit.interval(name)
    unit = one.unit.replace("*", " ")
    print(f"{name:24}{one.believed:10.5g}{one.value:12.5g}{true:8.5g}  {unit:8}{low:.6g} to {high:.6g}")
    assert abs(one.value - true) < 1e-3 * true

# %% [markdown]
# `fit.axis` is the axis with these numbers, in the feed-forward of its controller, too. `fit.axis.write("drive.toml")`
# keeps it as a drive file.
#
# ## A new motor
#
# The motor is replaced, and the new one cogs: it pushes the table with a force of 3.6 N that repeats every 2.5 mm. No
# parameter of the model describes that. On the way up, the following error ripples by half a micrometre:

# %%
cogging = dd.effects.Cogging(period=0.0025, cosine=3.0, sine=2.0)
new_motor = as_built.with_effects(cogging)

logs = [
    log_of(fit.axis, new_motor, to_and_fro(speed=0.030, stroke=0.012), "fast", seed=3),
    log_of(fit.axis, new_motor, to_and_fro(speed=0.008, stroke=0.003), "slow", seed=4),
]
before = log_of(fit.axis, as_built, to_and_fro(speed=0.030, stroke=0.012), "old motor", seed=3)

figure, panel = plt.subplots(figsize=(7.0, 3.2), layout="constrained")
for log, label in ((logs[0], "new motor"), (before, "old motor")):
    panel.plot(1e3 * log.position, 1e6 * (log.reference - log.position), linewidth=0.6, label=label)
panel.set(xlabel="position, mm", ylabel="following error, um", xlim=(1.0, 11.0), ylim=(14.5, 17.5))
panel.grid(alpha=0.3)
panel.legend()
plt.show()

# %% [markdown]
# ## Diagnose
#
# `diagnose` first recalibrates: do other numbers of the model explain the logs? Then it screens the effects of its
# catalogue, fits the most promising, and judges what it finds on data that were held out of the fit.

# %%
why = tuning.diagnose(fit.axis, logs)
why

# %% [markdown]
# The same as numbers, beside the truth:

# %%
cause, details = why.causes[0], why.details["causes"][0]
print(f"verdict: {why.verdict}; {cause.effect}, {100 * cause.confidence:.0f} % sure")
print(f"period: {1e3 * cause.parameters['period']:.4f} mm, in truth {1e3 * cogging.period:.4f} mm")
for log, cosine, sine in zip(logs, cause.parameters["cosine"], cause.parameters["sine"], strict=True):
    true = np.hypot(cogging.cosine, cogging.sine)
    print(f"amplitude in the {log.name} log: {np.hypot(cosine, sine):.3f} N, in truth {true:.3f} N")
print(
    f"missing force, held out: {details['gap_before']:.3g} N recalibrated, {details['gap_after']:.3g} N with the effect"
)
print(f"what noise alone makes of it: {why.details['gap']['noise_floor_force_N']:.3g} N")
assert why.verdict == "effect"
assert cause.effect == "cogging"
assert not cause.indistinguishable_from

# %% [markdown]
# The gap is closed down to its floor. 97 % is the most that a confidence is ever given, and no other effect can take
# the place of this one (`cause.indistinguishable_from` is empty).
#
# ## A motion that nothing was fitted to
#
# The proof is a motion that neither `identify` nor `diagnose` has seen: a sine. Each of the three models is simulated
# under the controller that ran. How far is its position from the logged one? The noise alone makes two logs of the
# same motion differ by as much as the last line says.

# %%
lap = dd.motion.sine(amplitude=0.006, frequency=0.5, duration=2.0, rate=data_sheet.rate)
held_out = log_of(fit.axis, new_motor, lap, "held out", seed=5)
models = {"data sheet": data_sheet, "identified": fit.axis, "identified, with cogging": why.axis}
compared = {name: log_of(fit.axis, model, lap, name, seed=6) for name, model in models.items()}
compared["the machine again"] = log_of(fit.axis, new_motor, lap, "again", seed=6)

gaps = {name: held_out.position - log.position for name, log in compared.items()}
for name, gap in gaps.items():
    print(f"{name:26}{1e6 * np.sqrt(np.mean(gap**2)):.4f} um RMS")

# %%
figure, panels = plt.subplots(len(models), 1, sharex=True, sharey=True, figsize=(7.0, 5.0), layout="constrained")
for panel, name in zip(panels, models, strict=True):
    panel.plot(1e3 * held_out.reference, 1e6 * gaps[name], linewidth=0.6)
    panel.set(title=name, ylabel="log - model, um")
    panel.grid(alpha=0.3)
panels[-1].set_xlabel("position, mm")
plt.show()

# %% [markdown]
# Wrong friction sets the two directions apart, and `identify` brings them together. The ripple is what the model leaves
# out. With the cogging only noise remains.
#
# `why.axis` is the axis with its cogging, to simulate, tune and sweep; `why.axis.write("augmented.toml")` makes it a
# drive file. With `experiments.report(why, "diagnosis")` the answer becomes a page for a colleague.
#
# - What the intervals mean: [identification](../../method/identification.md)
# - When an answer is believed: [diagnosis](../../method/diagnosis.md)
# - What to log: [record a log that can be diagnosed](../../how-to/record-a-log.md)
