"""A fit in a filter that forgives everything at first, and less and less.

Where blows are mistimed the cost is rough, and no step gains. A filter that may invent a large force follows the table
whatever strikes it: what remains is smooth, and the drive's own numbers fall into place. As the force is taken away,
the blows come to count.
"""

import numpy as np

from diffdrive.friction import coulomb
from tuning.diagnosis.fitting import DAMPING, ENOUGH, Fitted, Fitter
from tuning.diagnosis.following import Course
from tuning.diagnosis.model import Model, Vector

WARM, COOLER = 0.015, 3.0  # of the friction, that the process force is at first; by how much less it is each time
SUDDEN = 0.1  # of the lasting force
STEPS = 4  # under each


def cooled(fitter: Fitter, model: Model, u: Vector, course: Course) -> Fitted:
    """From `u`, under ever smaller process forces."""
    warm = max(WARM * float(coulomb(fitter.logged.drive.friction, 1.0, 0.0)), fitter.least)
    stages = 1 + int(np.ceil(np.log(warm / fitter.least) / np.log(COOLER)))
    free = np.ones(model.size)
    for lasting in warm / COOLER ** np.arange(stages):
        process = np.maximum(lasting * np.array([1.0, SUDDEN]), fitter.least)
        point, damping = fitter.at(model, u, process, course), DAMPING
        for _ in range(STEPS):
            ahead, damping = fitter.step(model, point, damping, free, fitter.jacobian(model, point))
            gained, point = point.cost - ahead.cost, ahead
            if not gained >= ENOUGH:
                break
        u, course = point.u, point.onward
    return fitter.fit(model, u, point.process, course)
