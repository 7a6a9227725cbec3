"""From nothing to the first result: `diffdrive simulate` in a process of its own, its cache empty and then full."""

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from experiments.studies.demo import PAPER_DRIVE

COMMAND = (sys.executable, "-c", "from experiments.cli.main import main; main()", "simulate", str(PAPER_DRIVE))
CODE = Path(__file__).resolve().parents[2]


def starts(warm: int = 3) -> tuple[float, list[float]]:
    """Seconds of the first call, and of each after it."""
    with tempfile.TemporaryDirectory(prefix="bench-cache-") as cache:
        paths = os.pathsep.join([str(CODE), *filter(None, [os.environ.get("PYTHONPATH")])])
        environment = os.environ | {"JAX_COMPILATION_CACHE_DIR": cache, "PYTHONPATH": paths}
        environment["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0.1"
        told = []
        for _ in range(1 + warm):
            began = time.perf_counter()
            subprocess.run(COMMAND, env=environment, check=True, stdout=subprocess.DEVNULL)
            told.append(time.perf_counter() - began)
    return told[0], told[1:]
