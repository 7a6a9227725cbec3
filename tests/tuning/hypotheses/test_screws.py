"""The search for a screw: it climbs to where the logs are likeliest, within what an engineer would call one."""

from types import SimpleNamespace

import numpy as np
import pytest

from tuning.diagnosis.hypotheses.candidates import candidates
from tuning.diagnosis.hypotheses.setting import Setting
from tuning.hypotheses import screws
from tuning.hypotheses.table import Entry

SETTING = Setting(100.0, 70.0, 4e-4, 2e3, 0.0, 3e-6, 5e-4, 9.0, -0.02, 0.02, 0.06, 200.0, 200.0)
KNOWN = {one.name: one for one in candidates(SETTING)}
TRUE = {
    "backlash": {"gap": 7.3e-6, "frequency": 310.0, "damping": 0.05, "motor_share": 0.62, "table_friction": 0.31},
    "compliance": {"frequency": 141.0, "damping": 0.06, "motor_share": 0.27, "table_friction": 0.71},
}


def hill(monkeypatch, true):
    """Evidence that falls with the square of how far each number is from the truth, in steps of the search."""
    seen = []

    def by_change(fitter, table, candidate, values):
        seen.append({name: float(value[0]) for name, value in values.items()})
        off = [
            (seen[-1][name] - value if name in screws.PARTS else np.log(seen[-1][name] / value)) / screws.STEPS[name]
            for name, value in true.items()
        ]
        return Entry(candidate, values, -float(np.sum(np.square(off))), np.zeros(0))

    monkeypatch.setattr(screws, "by_change", by_change)
    return by_change, seen


@pytest.mark.parametrize("name", TRUE)
def test_it_ends_within_a_fine_step_of_the_truth(name, monkeypatch):
    by_change, seen = hill(monkeypatch, TRUE[name])
    table = SimpleNamespace(fitted=SimpleNamespace(model=SimpleNamespace(logged=SimpleNamespace(logs=2))))
    points = [by_change(None, table, KNOWN[name], values) for values in screws.places(KNOWN[name], 2)]
    best = screws.refined(None, table, max(points, key=lambda one: one.evidence))
    assert best.evidence > -len(TRUE[name]) * 0.25**2  # in each number half of the last step, a quarter of the first
    assert len(seen) < 150
    for place in seen:
        assert all(low < place[bound] < high for bound, low, high in KNOWN[name].bounds)


def test_it_keeps_within_the_bounds_where_the_logs_lead_beyond_them(monkeypatch):
    by_change, seen = hill(monkeypatch, TRUE["compliance"] | {"damping": 40.0, "motor_share": 1.4})
    table = SimpleNamespace(fitted=SimpleNamespace(model=SimpleNamespace(logged=SimpleNamespace(logs=1))))
    first = by_change(None, table, KNOWN["compliance"], screws.places(KNOWN["compliance"], 1)[2])
    screws.refined(None, table, first)
    assert max(place["damping"] for place in seen) < 0.5
    assert max(place["motor_share"] for place in seen) < 0.95
