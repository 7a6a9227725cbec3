"""The time of `diffdrive simulate` in a new process, with its compilation cache empty and then full."""

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from diffdrive.library import PAPER_DRIVE

COMMAND = (sys.executable, "-c", "from experiments.cli.main import main; main()", "simulate", str(PAPER_DRIVE))
REPOSITORY = Path(__file__).resolve().parents[2]


def start_times(warm: int = 3) -> tuple[float, list[float]]:
    """Seconds of the first call, and of each after it."""
    with tempfile.TemporaryDirectory(prefix="bench-cache-") as cache:
        paths = os.pathsep.join([str(REPOSITORY), *filter(None, [os.environ.get("PYTHONPATH")])])
        environment = os.environ | {"JAX_COMPILATION_CACHE_DIR": cache, "PYTHONPATH": paths}
        environment["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0.1"
        seconds = []
        for _ in range(1 + warm):
            start = time.perf_counter()
            subprocess.run(COMMAND, env=environment, check=True, stdout=subprocess.DEVNULL)
            seconds.append(time.perf_counter() - start)
    return seconds[0], seconds[1:]
