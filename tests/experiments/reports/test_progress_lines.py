"""Progress of a job that no terminal watches."""

import io
import threading
import time

import pytest
from rich.console import Console

from experiments.reports.report import Report
from tuning.diagnosis.fits.threads import in_parallel


def test_a_job_without_a_terminal_sees_each_stage_begin_and_end_each_time():
    written = io.StringIO()
    with Report("job", None, Console(file=written, width=120)) as report, report.stages() as progress:
        for stage, most in (("screening", 3), ("fitting", 2), ("screening", 3), ("screening", 3)):
            in_parallel(
                lambda item: item, range(most), lambda done, stage=stage, most=most: progress(stage, done, most)
            )
    lines = [line.partition(",")[0] for line in written.getvalue().splitlines()[1:]]
    screening, fitting = ["screening: 0 of 3", "screening: 3 of 3"], ["fitting: 0 of 2", "fitting: 2 of 2"]
    assert lines == screening + fitting + screening + screening


def test_an_interrupt_does_not_wait_for_what_runs():
    running, began = threading.Event(), time.monotonic()

    def interrupted(done):
        if done:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        in_parallel(lambda item: item and running.wait(60.0), (0, 1, 2, 3), interrupted)
    assert time.monotonic() - began < 10.0
    running.set()
