# %% [markdown]
# # Simulate and differentiate
#
# A feed drive in closed loop is one differentiable function: from gains, machine and load to the tracking error. This
# notebook simulates a lap, takes the derivative of its error by a gain, checks it against a difference, and runs
# sixteen loads at once.

# %%
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt

import diffdrive as dd

dd.configure()  # double precision and the compiler's flags: explicit, never on import

# %% [markdown]
# ## An axis and a lap
#
# The axis is the testbed of Lee et al. 2015: 100 kg on linear guides, a scale with steps of 0.1 um, and a controller
# that runs at 10 kHz. The lap goes to and fro at 10 mm/s.

# %%
axis = dd.paper_axis("pd+fc+ls")
lap = dd.motion.triangular(speed=0.010, stroke=0.004, rounding=0.1, duration=1.0, rate=axis.rate)
axis

# %% [markdown]
# ## Simulate
#
# `simulate` returns every signal, and a status that says whether to believe them. Compare PD feedback alone with the
# friction observer that also estimates the load, here 8 kN.

# %%
runs = {kind: dd.simulate(dd.paper_axis(kind), lap, load=8_000.0) for kind in ("pd", "pd+fc+ls")}
for kind, run in runs.items():
    print(f"{kind:10}{run}")

# %%
figure, axes = plt.subplots(len(runs), 1, sharex=True, figsize=(7.0, 4.0), layout="constrained")
for panel, (kind, run) in zip(axes, runs.items(), strict=True):
    panel.plot(run.time, 1e6 * run.error)
    panel.set(title=kind, ylabel="error, um")
    panel.grid(alpha=0.3)
axes[-1].set_xlabel("time, s")
plt.show()

# %% [markdown]
# PD alone needs an error of 11 um to hold against friction, and the error changes its sign with the direction. The
# observer takes that force over: what is left is a few tenths of a micrometre at the reversals.
#
# ## Differentiate
#
# `rollout` is the same loop as a pure function, for `jit`, `grad` and `vmap`. The exact axis rounds (the scale has
# steps) and switches (friction changes its sign), so a gradient takes `axis.smooth()`.


# %%
def rms_error(kp, load):
    """RMS tracking error (m)."""
    return dd.rollout(axis.smooth().with_gains(kp=kp), lap, load=load).rms_error()


kp = axis.gains["kp"]
error, slope = jax.jit(jax.value_and_grad(rms_error))(kp, 8_000.0)
print(f"{1e6 * error:.4f} um RMS; 1 % more kp changes it by {1e6 * slope * 0.01 * kp:+.6f} um")

# %% [markdown]
# Is it right? A central difference is an independent answer.

# %%
step = 1e-4 * kp
difference = (rms_error(kp + step, 8_000.0) - rms_error(kp - step, 8_000.0)) / (2.0 * step)
print(f"gradient {slope:.6e}, difference {difference:.6e} m per N/m")
assert abs(slope - difference) < 1e-3 * abs(difference)

# %% [markdown]
# ## Many loads at once
#
# `vmap` makes one program of sixteen loops. They run side by side in the vector units of the processor.

# %%
loads = jnp.linspace(0.0, 12_600.0, 16)
errors = jax.jit(jax.vmap(rms_error, in_axes=(None, 0)))(kp, loads)

figure, panel = plt.subplots(figsize=(7.0, 3.2), layout="constrained")
panel.plot(1e-3 * loads, 1e6 * errors, "o-")
panel.set(xlabel="load, kN", ylabel="tracking error, um RMS")
panel.grid(alpha=0.3)
plt.show()

# %% [markdown]
# The gains are the paper's, and they suit a small load better than a large one. What to do about it:
# [tuning](../../method/tuning.md). The functions: [the reference](../../reference/api/diffdrive.md).
