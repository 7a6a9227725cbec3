"""The levels at which the diagnosis decides: what several of its parts hold an explanation against.

Where logs are of a machine that the model describes, chance is all there is: such levels follow from two probabilities.
No model describes a machine in full. What the details of a right model make of a log, no probability tells: that is a
share of what there is to explain, by how much the model is an idealisation.
"""

from math import log

from tuning.diagnosis.filter.ekf import LOST

CHANCE = 1e-6  # that a sound machine seems to have more: one log in a million
DECLARED = 0.05  # of probability against the best: a hypothesis that likely is not excluded
EFFECTS = 21  # that are tried: the catalogue's
SURELY = 2.0  # standard deviations, by which what differs stands out

LACKING = -2.0 * log(CHANCE)  # of cost: what two process forces gain by chance (chi-square, two degrees of freedom)
BLOWS = LOST**2  # of cost, at least, that one sample counts at which the filter was lost
WORTH = 2.0 * log(
    EFFECTS * (1.0 / DECLARED - 1.0)
)  # in evidence, that an effect must bring: `DECLARED` after all trials
EXCLUDED = -log(DECLARED)  # temperatures, by which a rival is no alternative
COLDEST = LACKING / EXCLUDED  # the temperature at least: what excludes a rival would be missed without any

LEFT = 0.02  # of what there was: what a model of the right kind may leave, or gain by its form
DETAILS = 0.05  # the same beside a coarse effect, and of what was gained: what the details of an effect may make
COARSE = 0.2  # the same of one effect alone whose details differ from machine to machine

STRAINED = 4.0  # standard deviations of its prior, beyond which a nominal parameter makes up for something else
IMPOSSIBLE = 6.0  # of the same: what no machine of this drive file has, and is explained before anything else
