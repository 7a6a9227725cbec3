"""What `configure` sets, in a process of its own: what is compiled is kept, and forgotten when nobody uses it."""

import os
import subprocess
import sys
import time

import pytest

PROGRAM = """
import platformdirs
platformdirs.user_cache_dir = lambda *_, **__: {home!r}
import jax
before = jax.config.jax_enable_x64
import diffdrive as dd
assert jax.config.jax_enable_x64 == before, "an import changes nothing"
dd.configure()
assert jax.config.jax_enable_x64
print(jax.config.jax_compilation_cache_dir)
print(jax.config.jax_persistent_cache_min_compile_time_secs)
"""


def cache_dir(home, **more):
    return configured(home, **more)[0]


def configured(home, **more):
    """Where programs are kept, and after how long a compilation (s)."""
    cleared = {name: value for name, value in os.environ.items() if not name.startswith("JAX_")}
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM.format(home=str(home))],
        capture_output=True, text=True, check=False, env=cleared | more,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


def test_programs_are_kept_until_nobody_has_used_them_for_two_months(tmp_path):
    folder = tmp_path / "compiled"
    folder.mkdir()
    for name, days in (("fresh", 0), ("used", 50), ("forgotten", 70)):
        (folder / name).write_text("a program")
        os.utime(folder / name, (time.time() - days * 86_400,) * 2)
    assert cache_dir(tmp_path) == str(folder)
    assert {path.name for path in folder.iterdir()} == {"fresh", "used"}


@pytest.mark.long
def test_the_environment_decides_where_and_whether(tmp_path):
    assert configured(tmp_path, JAX_COMPILATION_CACHE_DIR="elsewhere") == ["elsewhere", "0.1"]
    asked = {"JAX_COMPILATION_CACHE_DIR": "elsewhere", "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "3"}
    assert configured(tmp_path, **asked) == ["elsewhere", "3.0"]
    assert cache_dir(tmp_path, JAX_ENABLE_COMPILATION_CACHE="0") == "None"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(os.name == "nt", reason="a file in the folder's place")
def test_where_nothing_can_be_kept_nothing_is(tmp_path):
    (tmp_path / "file").write_text("no folder")
    assert cache_dir(tmp_path / "file") == "None"
