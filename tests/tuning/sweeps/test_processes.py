"""No process outlives the one that asked for it, whatever it computes."""

import os
import signal
import subprocess
import sys
import time

import pytest

pytestmark = pytest.mark.skipif(os.name == "nt", reason="POSIX signals")

ASKS = """
import os, sys, time
sys.path.insert(0, "{here}")
from computing import long
from diffdrive.support.processes import processes
if __name__ == "__main__":
    with processes(2) as pool:
        running = [pool.submit(long) for _ in range(2)]
        while not all(one.running() for one in running): time.sleep(0.01)
        time.sleep(1.0)
        print(*pool._processes, flush=True)
        running[0].result()
"""
COMPUTES = """
import hashlib
def long():
    hashlib.pbkdf2_hmac("sha256", b"", b"", 10**9)
"""


def alive(process):
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    return True


@pytest.mark.long
@pytest.mark.parametrize("which", [signal.SIGKILL, signal.SIGINT])
def test_processes_end_with_the_one_that_asked(tmp_path, which):
    (tmp_path / "computing.py").write_text(COMPUTES)
    (tmp_path / "asks.py").write_text(ASKS.format(here=tmp_path))
    with subprocess.Popen(
        [sys.executable, str(tmp_path / "asks.py")], env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)},
        stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
    ) as process:  # fmt: skip
        try:
            begun = [int(one) for one in process.stdout.readline().split()]
            assert len(begun) == 2
            process.send_signal(which)
            assert process.wait(10.0)
        finally:
            process.kill()  # else a failure waits for hours of computing
    until = time.monotonic() + 5.0
    while any(map(alive, begun)) and time.monotonic() < until:
        time.sleep(0.05)
    left = [one for one in begun if alive(one)]
    for one in left:
        os.kill(one, signal.SIGKILL)
    assert left == []
