"""Structured Text compiled by MatIEC, with its runtime, and run by a program in C around it."""

import os
import shutil
import subprocess

import pytest

from tests.support.exported import has

with_matiec = pytest.mark.skipif(
    not has("iec2c"), reason="no MatIEC (iec2c) on this machine: build github.com/beremiz/matiec"
)
# Some controllers stop the task at an invalid operation, a division by zero or an overflow: TRAPS does so here. Without
# it they are masked, whatever the runtime begins with.
HARNESS = """
#define _GNU_SOURCE
#include "POUS.h"
#include <fenv.h>
#include <math.h>
#include <stdio.h>
#include "POUS.c"
TIME __CURRENT_TIME;
BOOL __DEBUG;
int main(void)
{
    static %(block)s block;
    %(block)s_init__(&block, 0);
    fesetenv(FE_DFL_ENV);
#if defined(TRAPS) && defined(__GLIBC__)
    feenableexcept(FE_DIVBYZERO | FE_INVALID | FE_OVERFLOW);
#endif
    for (int call = 0; call < %(calls)d; ++call) {
        %(before)s
        %(block)s_body__(&block);
        %(after)s
    }
    %(end)s
}
"""


def harness(block, calls, before="", after="", end="return 0;"):
    """A program that calls a block so many times, with statements of C before and after each, and at the end."""
    return HARNESS % {"block": block.upper(), "calls": calls, "before": before, "after": after, "end": end}


def run_by_matiec(text, program, folder, *, traps):
    """Structured Text compiled with a program around it, and run."""
    (folder / "axis_x.st").write_text(text)
    (folder / "harness.c").write_text(program)
    matiec = os.environ.get("IEC2C", "iec2c")
    library = os.environ.get("MATIEC_LIB") or os.path.join(os.path.dirname(shutil.which(matiec)), "lib")
    made = subprocess.run(
        [matiec, "-I", library, "-T", str(folder), "axis_x.st"], cwd=folder, capture_output=True, text=True
    )
    assert made.returncode == 0, made.stderr
    flags = ["-w", f"-I{library}/C", *(["-DTRAPS"] if traps else [])]
    subprocess.run(["gcc", *flags, "-o", "bench", "harness.c", "-lm"], cwd=folder, check=True)
    return subprocess.run([folder / "bench"], cwd=folder, capture_output=True, text=True)
