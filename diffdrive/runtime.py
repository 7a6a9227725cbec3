"""What an entry point sets before it computes: double precision, and the flags that make a CPU scan fast.

The library itself changes no global state; the command line, the studies and the tests call `configure` first.
"""

import contextlib
import os
import platform
import time
from pathlib import Path

import jax
import numpy as np
import platformdirs

# Without these, jax before 0.12 dispatches each small operation of the loop on its own, five to twenty times slower
# (docs/method/numerics.md); from 0.12 on they widen the vectors.
_XLA_FLAGS = (
    "--xla_cpu_prefer_vector_width=512",
    "--xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold=1000000000,xla_cpu_disable_loop_unrolling",
)


_DEVICE_COUNT_FLAG = "--xla_force_host_platform_device_count"
_MIN_COMPILE_TIME = 0.1  # s of compilation, for which a program is kept
_FORGET_AFTER = 60 * 86_400.0  # s without use: a season, over which each edition of the sources has left programs


def _set(option: str, value: object) -> None:
    jax.config.update(option, value)  # type: ignore[no-untyped-call]  # jax declares no types of it


def cores() -> int:
    """The processor's cores that this process may run on."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def configure(devices: int | None = None) -> None:
    """Set double precision, fast CPU scans, one CPU device per core, and no GPU (`allow_accelerator` permits one).

    Call it once, before anything is computed. Environment variables that are set stay in force. What is compiled is
    kept in the user's cache folder for the next run, since compilation is most of a short program's time; jax
    recognises programs by content, version, flags and processor. `JAX_COMPILATION_CACHE_DIR` names another folder,
    `JAX_ENABLE_COMPILATION_CACHE=0` turns it off; where nothing can be written nothing is kept.

    Args:
        devices: CPU devices, over which many lanes are shared out; by default one per core.

    Examples:
        >>> import diffdrive as dd
        >>> dd.configure()

    """
    flags = os.environ.get("XLA_FLAGS", "").split()
    names = {flag.split("=")[0] for flag in flags}
    flags += [flag for flag in _XLA_FLAGS if flag.split("=")[0] not in names]
    os.environ["XLA_FLAGS"] = " ".join(flags)
    _set("jax_enable_x64", True)
    if "JAX_PLATFORMS" not in os.environ:  # a lane or a few take a hundred times as long on a GPU
        _set("jax_platforms", "cpu")
    if "JAX_NUM_CPU_DEVICES" not in os.environ and _DEVICE_COUNT_FLAG not in names:
        # once the backend runs, the number of devices is fixed: then it stays as it is
        with contextlib.suppress(RuntimeError):
            _set("jax_num_cpu_devices", devices or cores())
    _enable_compilation_cache()


def allow_accelerator() -> None:
    """After `configure`: run on a GPU if jax finds one, which pays for very many lanes."""
    if "JAX_PLATFORMS" not in os.environ:
        _set("jax_platforms", None)


def arithmetic_signature() -> list[str]:
    """What the last bits of a result depend on beside the program: device, the processor's vector units, flags."""
    vectors = np.show_config(mode="dicts").get("SIMD Extensions", {}).get("found", [])
    flags = [flag for flag in os.environ.get("XLA_FLAGS", "").split() if not flag.startswith(_DEVICE_COUNT_FLAG)]
    return [jax.default_backend(), jax.devices()[0].device_kind, platform.machine(), *vectors, *sorted(flags)]


def _enable_compilation_cache() -> None:
    """Keep what is compiled, and forget what nobody has used for long: jax itself never does without a lock."""
    if not jax.config.jax_enable_compilation_cache:
        return
    if "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS" not in os.environ:
        _set("jax_persistent_cache_min_compile_time_secs", _MIN_COMPILE_TIME)
    if jax.config.jax_compilation_cache_dir is not None:
        return
    folder = Path(platformdirs.user_cache_dir("diffdrive", appauthor=False)) / "compiled"
    with contextlib.suppress(OSError):  # another process may forget the same
        folder.mkdir(parents=True, exist_ok=True)
        for program in folder.iterdir():
            if time.time() - program.stat().st_atime > _FORGET_AFTER:
                program.unlink()
    if os.access(folder, os.W_OK):
        _set("jax_compilation_cache_dir", str(folder))
