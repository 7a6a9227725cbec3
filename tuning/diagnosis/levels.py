"""The levels at which the diagnosis decides: what several of its parts hold an explanation against.

Where logs are of a machine that the model describes, chance is all there is: those levels follow from two
probabilities. No model describes a machine in full. What the details of a right model make of a log, no probability
tells: that is a share of what there is to explain, by how much the model is an idealisation. How each follows:
docs/method/diagnosis-method.md#the-numbers-that-decide.
"""

from math import log

CHANCE = 1e-6  # that a sound machine seems to have more, at most
DECLARED = 0.05  # of probability against the best: a hypothesis that likely is not excluded
TESTED = 21  # effects of the catalogue
LOST = 6.0  # standard deviations; a filter that is so far off begins again from the measurement
SURELY = 2.0  # standard deviations, by which what differs stands out

# of cost, up to which nothing is missing: two process forces gain more with at most that chance (chi-square, two
# degrees of freedom); and of evidence: a hypothesis that is not true brings as much with at most that chance (Markov)
LACKING = -2.0 * log(CHANCE)
BLOWS = LOST**2  # of cost, of a sample at which the filter was lost: about what the filter itself counts it
WORTH = 2.0 * log(TESTED / DECLARED)  # of evidence, that an effect must bring: by chance any of them does so seldom
EXCLUDED = -log(DECLARED)  # temperatures, by which a rival is no alternative
COLDEST = LACKING / EXCLUDED  # the temperature at least: who lacks `LACKING` of evidence is excluded

LEFT = 0.02  # of what there was: what a model of the right kind may leave, and gain by its form alone
DETAILS = 0.05  # what the details of what was found may make: of evidence, and beside a coarse effect of what is left
COARSE = 0.2  # what the details of a coarse effect may make: of what it leaves alone, and of evidence beside it

STRAINED = 4.0  # standard deviations of its prior, beyond which a nominal parameter makes up for something else
IMPOSSIBLE = 6.0  # of the same: what no machine of this drive file has, and is explained before anything else
