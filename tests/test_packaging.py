"""What a stranger installs: the wheel's content, imports without side effects, and the order of the packages."""

import ast
import importlib.util
import os
import shutil
import subprocess
import sys
import tomllib
import zipfile
from importlib import metadata
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("diffdrive", "tuning", "experiments")
SOURCES = [path for package in PACKAGES for path in sorted((ROOT / package).rglob("*.py"))]


def module_name(path):
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imports_of(path):
    """The full names of all modules that a file imports, wherever in the file it does."""
    name = module_name(path)
    package = name.split(".") if path.name == "__init__.py" else name.split(".")[:-1]
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"), filename=str(path))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            above = package[: len(package) - node.level + 1] if node.level else []
            base = ".".join([*above, *filter(None, [node.module])])
            yield from (f"{base}.{alias.name}" for alias in node.names)


@pytest.mark.parametrize("path", SOURCES, ids=module_name)
def test_imports_point_from_experiments_to_tuning_to_diffdrive(path):
    allowed = PACKAGES[: PACKAGES.index(module_name(path).split(".")[0]) + 1]
    imported = {name for name in imports_of(path) if name.split(".")[0] in {*PACKAGES, "tests"}}
    assert {name.split(".")[0] for name in imported} <= set(allowed)
    assert not any(name.startswith("experiments.bootstrap") for name in imported)


# what a part of diffdrive imports stands above it, or in its own line
LAYERS = (
    ("errors", "support"),
    ("runtime", "results"),
    ("numerics",),
    ("model",),
    ("observers",),
    ("logs",),  # of a log itself; what asks an axis stands below
    ("motion", "frequency"),
    ("effects",),
    ("controllers",),
    ("loop",),
    ("axis",),
    (
        "axis_file",
        "library",
        "paper",
        "simulation",
        "linearisation",
        "measured_loop",
        "motion.text",
        "motion.reference",
        "logs.checks",
        "logs.encoders",
        "logs.guess",
    ),
)
UPWARDS = {  # the imports that may go the other way: of a type alone, or where a method is called
    "diffdrive.axis.Axis": "diffdrive.logs.read",
    "diffdrive.axis_file.drive_file.write_axis": "diffdrive.axis",
}
RANKS = {f"diffdrive.{part}": rank for rank, layer in enumerate(LAYERS) for part in layer}


def rank_of(name):
    """The layer of a module of diffdrive, by the longest name that it begins with."""
    parts = name.split(".")
    return next(rank for k in range(len(parts), 1, -1) if (rank := RANKS.get(".".join(parts[:k]))) is not None)


@pytest.mark.parametrize("path", [path for path in SOURCES if path.is_relative_to(ROOT / "diffdrive")], ids=module_name)
def test_imports_within_diffdrive_point_from_the_whole_to_its_parts(path):
    name = module_name(path)
    imported = [other for other in imports_of(path) if other.startswith("diffdrive.")]
    against = [
        other
        for other in imported
        if rank_of(other) > rank_of(name) and not name.startswith(UPWARDS.get(other, "nothing"))
    ]
    assert against == []


DIAGNOSIS = (
    "levels",
    "blocks",
    "filter",
    "hypotheses",
    "fits",
    "gap",
    "selection",
    "judgement",
    "limits",
)  # each uses those before it


@pytest.mark.parametrize(
    "path", [path for path in SOURCES if path.is_relative_to(ROOT / "tuning" / "diagnosis")], ids=module_name
)
def test_the_parts_of_the_diagnosis_use_those_before_them(path):
    part = module_name(path).split(".")[2:3]
    rank = DIAGNOSIS.index(part[0]) if part and part[0] in DIAGNOSIS else len(DIAGNOSIS)
    imported = {other.split(".")[2] for other in imports_of(path) if other.startswith("tuning.diagnosis.")}
    assert not [other for other in imported if other in DIAGNOSIS and DIAGNOSIS.index(other) > rank]
    assert not imported - set(DIAGNOSIS) or rank == len(DIAGNOSIS)


def run_code(code):
    """Run code in a Python of its own, without what the tests themselves have set for jax."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("XLA_", "JAX_"))}
    return subprocess.run([sys.executable, "-c", code], cwd=ROOT, env=kept, capture_output=True, text=True, check=False)


IMPORT_ALL = """
import importlib, json, os
import jax
from jax._src import xla_bridge

def state():
    return {"config": {name: repr(value) for name, value in jax.config.values.items()}, "environment": dict(os.environ)}

before = state()
for name in NAMES:
    importlib.import_module(name)
after = state()
changed = {key: [before[part].get(key), after[part].get(key)] for part in before
           for key in {*before[part], *after[part]} if before[part].get(key) != after[part].get(key)}
print(json.dumps({"changed": changed, "backends": sorted(xla_bridge._backends)}))
"""


@pytest.mark.parametrize(
    "submodules", [False, pytest.param(True, marks=pytest.mark.long)], ids=["packages", "all_modules"]
)
def test_importing_changes_and_prints_nothing(submodules):
    skipped = ("experiments.bootstrap", "experiments.__main__", "diffdrive.__main__")
    names = [name for name in map(module_name, SOURCES) if name not in skipped] if submodules else list(PACKAGES)
    if importlib.util.find_spec("nicegui") is None:  # of the extra `app`
        names = [name for name in names if not name.startswith("experiments.app.web.")]
    done = run_code(f"NAMES = {names!r}\n{IMPORT_ALL}")
    assert done.returncode == 0, done.stderr
    assert done.stdout == '{"changed": {}, "backends": []}\n'
    # matplotlib announces a slow first start
    assert [line for line in done.stderr.splitlines() if "font cache" not in line] == []


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """The wheel, built from a copy: a build leaves folders behind that a later one would pack again."""
    if importlib.util.find_spec("pip") is None:
        pytest.skip("needs pip")
    source, out = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("wheel")
    for package in PACKAGES:
        shutil.copytree(ROOT / package, source / package, ignore=shutil.ignore_patterns("__pycache__"))
    for path in ROOT.iterdir():
        if path.suffix in (".toml", ".md") or path.name.startswith("LICENSE"):
            shutil.copy(path, source)
    command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--wheel-dir", str(out), str(source)]
    if setuptools_is_new_enough():
        command.append("--no-build-isolation")  # saves fetching it
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if "Retry(total=0" in done.stderr:
        pytest.skip("offline, and no setuptools here to build with")
    assert done.returncode == 0, done.stdout + done.stderr
    [path] = out.glob("*.whl")
    with zipfile.ZipFile(path) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def setuptools_is_new_enough():
    try:
        return int(metadata.version("setuptools").split(".")[0]) >= 77
    except metadata.PackageNotFoundError:
        return False


@pytest.mark.long
def test_wheel_carries_every_module_and_data_file(wheel):
    data = [*(ROOT / "diffdrive" / "library").glob("*.toml")]
    data += [ROOT / package / "py.typed" for package in PACKAGES]  # and what the public names are looked up in
    data += [path for package in PACKAGES for path in (ROOT / package).rglob("*.pyi")]
    page = ROOT / "experiments" / "reports" / "page"
    data += [*page.glob("templates/*.jinja"), *page.glob("assets/*")]
    wanted = {path.relative_to(ROOT).as_posix() for path in [*SOURCES, *data]}
    assert wanted <= set(wheel)


@pytest.mark.long
def test_wheel_carries_nothing_else(wheel):
    assert {name.split("/")[0] for name in wheel if ".dist-info/" not in name} == set(PACKAGES)


@pytest.mark.long
def test_wheel_has_the_console_script(wheel):
    [text] = [content.decode() for name, content in wheel.items() if name.endswith("entry_points.txt")]
    assert "diffdrive = experiments.cli.main:main" in text.splitlines()
    assert "experiments/cli/main.py" in wheel


@pytest.mark.long
def test_wheel_names_the_pythons_it_runs_on(wheel):
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    [text] = [content.decode() for name, content in wheel.items() if name.endswith(".dist-info/METADATA")]
    assert f"Requires-Python: {project['requires-python']}" in text.splitlines()
    assert f"Version: {project['version']}" in text.splitlines()
