"""A fit in a filter that forgives everything at first, and less and less.

Where blows are mistimed the cost is rough, and no step gains. A filter that may invent a large force follows the table
whatever strikes it: what remains is smooth, and the drive's own numbers fall into place. As the force is taken away,
the blows come to count.
"""

import numpy as np

from tuning.diagnosis.fitting import DAMPING, ENOUGH, Fitted, Fitter
from tuning.diagnosis.following import Course
from tuning.diagnosis.model import Model, Vector

WARM, COOLER = 1e3, 3.0  # times the least process force, at first; by how much less each time
SUDDEN = 0.1  # of the lasting force
STEPS = 4  # under each


def cooled(fitter: Fitter, model: Model, u: Vector, course: Course) -> Fitted:
    """From `u`, under ever smaller process forces."""
    stages = 1 + int(np.ceil(np.log(WARM) / np.log(COOLER)))
    free = np.ones(model.size)
    for lasting in np.maximum(WARM / COOLER ** np.arange(stages), 1.0):
        process = fitter.least * np.maximum(lasting * np.array([1.0, SUDDEN]), 1.0)
        point, damping = fitter.at(model, u, process, course), DAMPING
        for _ in range(STEPS):
            ahead, damping = fitter.step(model, point, damping, free, fitter.jacobian(model, point))
            gained, point = point.cost - ahead.cost, ahead
            if not gained >= ENOUGH:
                break
        u, course = point.u, point.onward
    return fitter.fit(model, u, point.process, course)
