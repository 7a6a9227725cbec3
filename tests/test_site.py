"""The documentation site has every public name, and the programs that its pages are run."""

import importlib
import importlib.util
import re
from pathlib import Path

import pytest

import diffdrive
import experiments
import tuning

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"
FACADES = [
    diffdrive, diffdrive.motion, diffdrive.load, diffdrive.effects, diffdrive.controllers, diffdrive.logs,
    tuning, experiments,
]  # fmt: skip
ENTRY = re.compile(r"^::: ([\w.]+)$", re.M)


def resolved(path):
    """The object that a dotted path of the reference leads to."""
    package, *names = path.split(".")
    found = importlib.import_module(package)
    for name in names:
        found = getattr(found, name, None) or importlib.import_module(f"{found.__name__}.{name}")
    return found


def hook(name):
    """A module of the site's hooks, which are no package."""
    spec = importlib.util.spec_from_file_location(name, DOCS / "hooks" / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def entries():
    pages = sorted((DOCS / "reference" / "api").glob("*.md"))
    texts = [hook("listed").listed(page.read_text(encoding="utf-8")) for page in pages]
    return [path for text in texts for path in ENTRY.findall(text)]


@pytest.mark.parametrize("facade", FACADES, ids=lambda facade: facade.__name__)
def test_every_public_name_has_one_entry_in_the_reference(facade, entries):
    described = [id(resolved(path)) for path in entries]
    names = [name for name in facade.__all__ if getattr(facade, name) not in FACADES]
    assert [name for name in names if described.count(id(getattr(facade, name))) != 1] == []


def test_every_entry_of_the_reference_has_a_docstring_of_its_own(entries):
    catalogues = {"diffdrive.effects.EFFECTS", "diffdrive.controllers.KINDS"}
    missing = [path for path in entries if path not in catalogues and "__doc__" not in vars(resolved(path))]
    assert [path for path in missing if not resolved(path).__doc__] == []


def test_the_pictures_of_the_gallery_are_those_that_its_code_saves():
    text = (DOCS / "gallery.md").read_text(encoding="utf-8")
    saved = re.findall(r"finish\(.*\"([\w.-]+)\"\)$", text, re.M)
    assert re.findall(r"\]\(figures/gallery/([\w.-]+)\)", text) == saved
    assert sorted(path.name for path in (DOCS / "figures" / "gallery").iterdir()) == sorted(saved)


SLOW = {"identify-and-diagnose", "tune-and-sweep"}  # minutes; each build of the site runs them, too


@pytest.mark.long
@pytest.mark.parametrize(
    "notebook",
    [
        pytest.param(path, marks=[pytest.mark.slow] if path.stem in SLOW else [], id=path.stem)
        for path in sorted((DOCS / "tutorials" / "notebooks").glob("*.py"))
    ],
)
@pytest.mark.filterwarnings("ignore::DeprecationWarning:jupyter_client")
def test_a_notebook_runs_and_shows_a_figure(notebook, tmp_path):
    executed = hook("executed")
    done = executed.run(executed.read(notebook), tmp_path)
    outputs = [output for cell in done.cells for output in cell.get("outputs", [])]
    assert any("image/png" in output.get("data", {}) for output in outputs)
    assert [output for output in outputs if output.get("name") == "stderr"] == []
    assert "Warning" not in str(outputs)  # rich displays some
