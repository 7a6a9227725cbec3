"""A cascade with one of each part that real loops have, and one with all of them."""

import dataclasses

from diffdrive import motion as motions
from diffdrive.controllers import PT1, PT2, Cascade, Feedforward, Notch, SecondOrder
from diffdrive.model.parameters import Sensor
from diffdrive.model.presets import paper_drive
from diffdrive.model.quantity import Directional

RATE = 8_000.0  # that of the filters in test_filters.py
PERIOD = 1.0 / RATE
IDEAL = paper_drive(quantised=False)
ROUGH = dataclasses.replace(IDEAL, sensor=Sensor(resolution=1e-7, noise=2e-8))
FEEDFORWARD = Feedforward(mass=120.0, damping=Directional(400.0, 200.0))
MOVE = motions.jerk_limited(
    distance=2e-3, speed=0.01, acceleration=1.0, jerk=100.0, rate=RATE, dwell=0.02, start=12.34564e-6
)
FILTERS = (Notch(700.0, 200.0, 25.0), PT2(1_500.0), PT1(1e-4), SecondOrder(1_100.0, 0.1, 900.0, 0.5))
WHOLE = Cascade(
    kp=120.0, kv=2e4, velocity_feedforward=0.9, feedforward=FEEDFORWARD, velocity_samples=2, reset_time=0.02,
    force_feedforward=0.8, force_limit=900.0, velocity_filter_time=3e-4, reference_filter_time=2e-3,
    reference_delay_samples=3, position_every=4, filters=FILTERS,
)  # fmt: skip
ONE_EACH = {
    "reset time": Cascade(120.0, 2e4, reset_time=0.02),
    "share of the feed-forward": Cascade(120.0, 2e4, feedforward=FEEDFORWARD, force_feedforward=0.6),
    "limit": Cascade(120.0, 2e4, 1e6, force_limit=150.0),
    "filter of the velocity": Cascade(120.0, 2e4, 1e6, velocity_filter_time=5e-4),
    "filter of the set-point": Cascade(120.0, 2e4, 1e6, reference_filter_time=2e-3),
    "delay of the set-point": Cascade(120.0, 2e4, 1e6, reference_delay_samples=5),
    "slower position loop": Cascade(120.0, 2e4, 1e6, position_every=5),
    "one notch": Cascade(120.0, 2e4, 1e6, filters=FILTERS[:1]),
}
