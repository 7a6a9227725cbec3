"""How often `tuning.compare` finds a change in a machine that has none, and one of the size that it says it would find.

    python -m experiments.studies.comparison_level

Pairs of estimates are drawn as two fits of an unchanged machine give them: correlated parameters, and covariances that
are themselves estimated from a number of blocks (Wishart). Prints a Markdown table.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.stats import wishart

from tuning.comparison.changes import Difference, Estimates

PAIRS = 2_000  # without a change, and with one
PARAMETERS = 13
BLOCKS = (60, 90)  # degrees of freedom of the covariances before and after
CORRELATED = 1.5  # standard deviation of what the parameters have in common, over that of what is their own
LEVELS = (0.01, 0.05, 0.2)
LEVEL = 0.01


def drawn(random: np.random.Generator, size: int, change: Float[np.ndarray, " k"]) -> Difference:
    """Two fits of one machine whose parameters differ by `change` standard deviations, and the difference of both."""
    common = CORRELATED * random.normal(size=(size, 1))
    true = common @ common.T + np.eye(size)
    sides = [
        Estimates(
            random.multivariate_normal(mean, true),
            np.asarray(wishart.rvs(blocks, true / blocks, random_state=random)),
            float(blocks),
        )
        for mean, blocks in zip((np.zeros(size), change), BLOCKS, strict=True)
    ]
    return Difference(tuple(f"p{k}" for k in range(size)), *sides)


class Level(NamedTuple):
    """What was counted."""

    below: tuple[float, ...]  # share of the unchanged pairs whose p-value is below each of `LEVELS`
    holds: float  # share of the 95 % intervals of one free change, the others unchanged, that hold it
    found: float  # share of the changes of the stated size that are found


def measured(pairs: int = PAIRS, seed: int = 1) -> Level:
    """The shares, over so many pairs of each kind that a seed draws."""
    random = np.random.default_rng(seed)
    unchanged = [drawn(random, PARAMETERS, np.zeros(PARAMETERS)) for _ in range(pairs)]
    p_values = np.array([one.p_unchanged(one.names) for one in unchanged])
    intervals = [one.intervals([name])[0] for one in unchanged for name in one.names]
    found = []
    for _ in range(pairs):
        state = random.bit_generator.state
        size = drawn(random, PARAMETERS, np.zeros(PARAMETERS)).smallest("p0", (), LEVEL)
        random.bit_generator.state = state  # the same pair, but for the change
        changed = drawn(random, PARAMETERS, np.r_[size, np.zeros(PARAMETERS - 1)])
        found.append(changed.p_unchanged(changed.names) <= LEVEL)
    holds = float(np.mean([one.low <= 0.0 <= one.high for one in intervals]))
    return Level(tuple(float(np.mean(p_values < one)) for one in LEVELS), holds, float(np.mean(found)))


if __name__ == "__main__":
    level = measured()
    print("| counted | share |\n|---|---|")
    for bound, share in zip(LEVELS, level.below, strict=True):
        print(f"| p-value of an unchanged machine below {bound:g} ({PAIRS} pairs) | {100 * share:.1f} % |")
    print(f"| 95 % intervals that hold no change | {100 * level.holds:.1f} % |")
    print(f"| changes of the stated size that are found ({PAIRS} pairs) | {100 * level.found:.0f} % |")
