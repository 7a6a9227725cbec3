"""An interrupted command ends in time, whatever it computes, and says truly what it leaves."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from experiments.cli.ending import describe_folder, file_stamps, out_folder

pytestmark = pytest.mark.skipif(os.name == "nt", reason="POSIX signals")

BEGIN = """
import gc, hashlib, os, sys, threading, time
from pathlib import Path
from experiments.cli import ending
ending.FIRST, ending.SECOND = 1.0, 0.3
watch = ending.SignalWatch(Path(sys.argv[1]))
watch.begin()
def computes():  # minutes in C, without the interpreter's lock and deaf to signals
    hashlib.pbkdf2_hmac("sha256", b"", b"", 10**9)
print("begun", flush=True)
"""


def ended(program, folder, *signals, apart=0.6, imports="", ready="begun"):
    """Exit code, what it said, and the seconds that it took from the last of the signals.

    The first comes when the program has printed `ready`, a busy machine or not.
    """
    with subprocess.Popen(
        [sys.executable, "-c", imports + BEGIN + program, str(folder)],
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    ) as process:
        assert f"{ready}\n" in iter(process.stdout.readline, "")
        time.sleep(0.1)
        for number, one in enumerate(signals):
            time.sleep(apart * bool(number))
            process.send_signal(one)
        began = time.monotonic()
        try:
            said = process.communicate(timeout=20.0)
        finally:
            process.kill()
        return process.returncode, "".join(said), time.monotonic() - began


@pytest.mark.parametrize("which", [signal.SIGINT, signal.SIGTERM])
def test_what_stays_in_compiled_code_is_ended_and_says_what_is_there(tmp_path, which):
    program = "(Path(sys.argv[1]) / 'one.csv').write_text('1'); (Path(sys.argv[1]) / '.two.csv').touch(); computes()"
    code, said, seconds = ended(program, tmp_path, which)
    assert code == 130
    assert said.splitlines()[-1] == f"interrupted, stopped at once; {tmp_path} holds, of this run: one.csv"
    assert seconds < 3.0


def test_a_reader_that_does_not_read_keeps_nothing_alive(tmp_path):
    """The pipe is full, and the main thread waits in the midst of a write."""
    program = "ending.FIRST = 0.2\nwhile True: sys.stdout.write('x' * 4096)"
    with subprocess.Popen(
        [sys.executable, "-c", BEGIN + program, str(tmp_path)], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
    ) as process:
        assert process.stdout.readline() == b"begun\n"
        time.sleep(0.3)
        process.send_signal(signal.SIGTERM)
        try:
            assert process.wait(10.0)
        finally:
            process.kill()


def test_a_second_signal_ends_it_sooner(tmp_path):
    code, said, seconds = ended("ending.FIRST = 60.0; computes()", tmp_path, signal.SIGTERM, signal.SIGTERM)
    assert code == 130
    assert said.endswith("interrupted, stopped at once; it had written nothing\n")
    assert seconds < 3.0


def test_two_signals_together_are_one(tmp_path):
    """`timeout` sends each process two."""
    program = "ending.SECOND = 0.0\ntry: time.sleep(60)\nexcept KeyboardInterrupt: time.sleep(0.4); print('written')"
    code, said, _ = ended(program, tmp_path, signal.SIGTERM, signal.SIGTERM, apart=0.05)
    assert (code, said) == (0, "written\n")


def test_an_interrupt_that_a_callback_swallows_comes_again(tmp_path):
    program = """
def swallows(*_):
    gc.callbacks.clear()
    threading.Thread(target=os.kill, args=(os.getpid(), 15)).start()
    time.sleep(0.2)
gc.callbacks.append(swallows)
try:
    gc.collect()
    for _ in range(200): time.sleep(0.01)
except KeyboardInterrupt: print("interrupted")
"""
    code, said, _ = ended(program, tmp_path)
    assert (code, said) == (0, "interrupted\n")


def test_an_interrupt_in_the_midst_of_a_compilation_is_no_failure(tmp_path):
    """The compiler calls Python back, and makes another exception of what that raises."""
    program = """
import os, signal, sys, time
from jax._src.interpreters import mlir
from jax._src.lib.mlir import ir
from experiments.cli import main
def interrupted(_):
    os.kill(os.getpid(), signal.SIGINT)
    time.sleep(10.0)
def compiles():
    with mlir.make_ir_context():
        ir.Module.parse("module { }").operation.walk(interrupted)
main.app = compiles
main.main()
"""
    ran = subprocess.run(
        [sys.executable, "-c", program, "--out", str(tmp_path)], text=True, capture_output=True, timeout=60.0
    )
    assert ran.returncode == 130, ran.stderr
    assert ran.stderr.splitlines() == ["", "interrupted, and what was written so far stays; it had written nothing"]


@pytest.mark.long
def test_results_are_written_in_peace_after_the_first_interrupt(tmp_path):
    program = """
ending.SECOND = 30.0
try: time.sleep(60)
except KeyboardInterrupt: time.sleep(1.5); print("written")
"""
    code, said, _ = ended("ending.FIRST = 60.0" + program, tmp_path, signal.SIGTERM, signal.SIGINT)
    assert (code, said) == (0, "written\n")


def test_what_is_left_is_of_this_run(tmp_path):
    """Whatever the clock says: one file is written in the very tick of the start, one a century later, one replaced."""
    (tmp_path / "parts").mkdir()
    for name in ("old.csv", "replaced.csv", "parts/old"):
        (tmp_path / name).write_text("1")
    os.utime(tmp_path / "old.csv", (4e9, 4e9))
    before = file_stamps(tmp_path)
    for name in ("new.csv", "parts/new", "parts/.half", ".half.csv"):
        (tmp_path / name).write_text("1")
    (tmp_path / ".half.csv").replace(tmp_path / "replaced.csv")
    os.utime(tmp_path / "new.csv", (1.0, 1.0))
    assert describe_folder(tmp_path, before) == (
        f"{tmp_path} holds, of this run: new.csv, parts (1 file), replaced.csv; the same command continues from parts"
    )
    assert describe_folder(tmp_path / "none", {}) == describe_folder(None, {}) == "it had written nothing"
    assert file_stamps(tmp_path / "none") == file_stamps(None) == {}


@pytest.mark.parametrize("words", [["tune", "a.toml", "--out", "b"], ["tune", "--out=b", "a.toml"]])
def test_the_folder_is_that_of_the_option(words):
    assert out_folder(words) == Path("b")
    assert out_folder(words[:1]) is None


@pytest.mark.long
def test_a_third_signal_does_not_break_the_writing_that_the_second_one_set_going(tmp_path):
    imports = """
from experiments.reports.interruption import stop_at_next_step
from experiments.reports.report import Report
"""
    program = """
ending.FIRST = ending.SECOND = 60.0
fsync = os.fsync
def slow(descriptor):
    for _ in range(20): time.sleep(0.1)
    fsync(descriptor)
try:
    with Report("a search", Path(sys.argv[1])) as report:
        report.values("kept", number=1)
        os.fsync = slow
        with stop_at_next_step(lambda *_: None, print):
            print("ready", flush=True)
            for _ in range(600): time.sleep(0.1)
except KeyboardInterrupt:
    pass
"""
    code, _, _ = ended(program, tmp_path, *[signal.SIGINT] * 3, apart=0.8, imports=imports, ready="ready")
    assert code == 0
    assert '"number": 1' in (tmp_path / "result.json").read_text()


def test_a_folder_that_was_made_for_nothing_is_gone_after_a_hard_end(tmp_path):
    imports = "from experiments.reports.report import Report\n"
    program = 'with Report("nothing yet", Path(sys.argv[1])): print("ready", flush=True); computes()'
    code, said, _ = ended(program, tmp_path / "made" / "here", signal.SIGINT, imports=imports, ready="ready")
    assert code == 130
    assert said.endswith("it had written nothing\n")
    assert not (tmp_path / "made").exists()
