"""The levels at which the diagnosis decides: what several of its parts hold an explanation against."""

LACKING = 30.0  # of cost
WORTH = 12.0  # in evidence, that an effect must bring
DECLARED = 0.05  # of probability against the best: a hypothesis that likely is not excluded
LEFT = 0.02  # of what was missing: what the details of a model of the right kind may leave
COARSE = 0.05  # the same for effects whose details differ from machine to machine
SLIGHT = 0.04  # of what was gained before, that another effect must bring: less may be the first one's details
STRAINED = 4.0  # standard deviations of its prior, beyond which a nominal parameter makes up for something else
IMPOSSIBLE = 6.0  # of the same: what no machine of this drive file has, and is explained before anything else
BLOCK = 0.25  # s, over which two explanations are compared: longer than what is left of structure lasts
