"""What the docs say of motions is what the code does; no link leads nowhere, and a link leads to every page."""

import contextlib
import importlib
import re
from pathlib import Path

import numpy as np
import platformdirs
import pytest

from diffdrive.axis_file import reference as drive_file
from diffdrive.controllers import KINDS
from diffdrive.effects import EFFECTS
from diffdrive.library import listing as library
from diffdrive.library.search import FOLDERS
from diffdrive.logs.formats.registry import READERS
from diffdrive.motion import reference as motions
from diffdrive.motion.text import LOAD_UNITS, LOADS, MOTION_UNITS, MOTIONS, parse_load, parse_motion

ROOT = Path(__file__).resolve().parent.parent
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
SOURCES = [file for part in ("diffdrive", "tuning", "experiments", "tests") for file in (ROOT / part).rglob("*.py")]
FILES = {file.name for file in SOURCES}
WORDS = {word for file in SOURCES for word in re.findall(r"\w+", file.read_text(encoding="utf-8"))}


def test_the_reference_of_drive_files_in_the_docs_is_current():
    """That of the effects stands where the effects are explained: a further one has one page."""
    rows = [*drive_file.reference()]
    effects = [row for row in rows if row[0].startswith("[effects.")]
    for page, its_own in (("drive-file.md", [row for row in rows if row not in effects]), ("effects.md", effects)):
        text = (ROOT / "docs" / "reference" / page).read_text(encoding="utf-8")
        assert drive_file.markdown(its_own) in text, f"{page}: `diffdrive keys` prints what it should hold"


CATALOGUES = {"effects.md": EFFECTS, "drive-file.md": KINDS, "logs.md": READERS}


@pytest.mark.parametrize(("page", "names"), CATALOGUES.items(), ids=CATALOGUES.keys())
def test_the_page_of_a_catalogue_explains_each_of_its_names(page, names):
    """In a row of its own, beside those of the keys, or among the extensions of a row."""
    text = (ROOT / "docs" / "reference" / page).read_text(encoding="utf-8")
    told = {word.strip("`") for cell in re.findall(r"^\|([^|]+)\|", text, re.M) for word in cell.split()}
    assert [name for name in names if name not in told] == []


def test_the_list_of_axes_in_the_docs_is_current(monkeypatch, tmp_path):
    monkeypatch.delenv(FOLDERS, raising=False)
    monkeypatch.setattr(platformdirs, "user_config_dir", lambda *_, **__: str(tmp_path))
    assert library.markdown() in (ROOT / "docs" / "reference" / "axes.md").read_text(encoding="utf-8")


def test_the_reference_of_motions_in_the_docs_is_current():
    page = (ROOT / "docs" / "reference" / "motions.md").read_text(encoding="utf-8")
    for table in motions.markdown().split("\n\n"):
        assert table.strip() in page


VALUES = {"m": "1mm", "m/s": "10mm/s", "m/s^2": "1", "m/s^3": "100", "s": "0.1", "Hz": "5", "N": "1kN", "rad": "0",
          "kg": "100", "kg/s": "1"}  # fmt: skip


def settings(told):
    """What the table says is needed, with values in the units that it names."""
    written = []
    for name, unit in re.findall(r"(\w+) \(([^()]*)\)", told):
        pairs, many = "pairs" in unit, "list" in unit
        value = VALUES[unit.split()[-1]]
        written.append(f"{name}={'0.1~0.2;0.3~0.4' if pairs else f'{value}' if many else value}")
    return ",".join(written)


@pytest.mark.parametrize("row", list(motions.reference(MOTIONS, MOTION_UNITS)), ids=lambda row: row[0])
def test_a_motion_needs_what_the_reference_says_and_no_more(row):
    text = settings(row[1]).replace("rounding=0.1", "rounding=0.05")
    assert parse_motion(f"{row[0]}:{text}", 1e4).duration > 0.0


@pytest.mark.parametrize("row", list(motions.reference(LOADS, LOAD_UNITS)), ids=lambda row: row[0])
def test_a_load_needs_what_the_reference_says_and_no_more(row):
    text = settings(row[1]).replace("end=0.1", "end=0.2")
    assert np.max(parse_load(f"{row[0]}:{text}", np.linspace(0.0, 1.0, 101))) > 900.0


def anchors(page):
    text = page.read_text(encoding="utf-8")
    titles = [line.lstrip("# ") for line in text.splitlines() if line.startswith("#")]
    made = {re.sub(r"[^\w -]", "", title.lower()).replace(" ", "-") for title in titles}
    return made | set(re.findall(r'<a id="([^"]+)"', text))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_link_leads_somewhere(page):
    for link in re.findall(r"\]\(([^)\s]+)\)", page.read_text(encoding="utf-8")):
        if link.startswith("http"):
            continue
        file, _, anchor = link.partition("#")
        there = page.parent / file if file else page
        assert there.exists(), link
        assert not anchor or anchor in anchors(there), link


def linked(page):
    """The pages that a page links, as files."""
    for link in re.findall(r"\]\(([^)\s#]+\.md)[^)\s]*\)", page.read_text(encoding="utf-8")):
        if not link.startswith("http"):
            yield (page.parent / link).resolve()


def test_the_readme_links_the_table_of_contents_which_leads_to_every_page():
    assert ROOT / "docs" / "index.md" in linked(ROOT / "README.md")
    reached, ahead = set(), [ROOT / "docs" / "index.md"]
    while ahead:
        page = ahead.pop()
        if page not in reached:
            reached.add(page)
            ahead.extend(linked(page))
    assert set(PAGES[1:]) <= reached, sorted(page.name for page in set(PAGES[1:]) - reached)


NAME = re.compile(r"`((?:diffdrive|tuning|experiments)(?:\.(?!json|png|toml|checkpoint)[A-Za-z_]\w*)+)")
IDENTIFIER = re.compile(r"`([a-z]+_\w+|[A-Z]+_\w+|[A-Z][a-z]+[A-Z]\w+)(?:\([^`]*\))?`")
FILE = re.compile(r"(?<![\w./-])((?:[\w-]+/)*[\w-]+\.py)\b")


def is_there(name):
    """Whether a dotted name is a module, or an attribute of one."""
    parts = name.split(".")
    for count in range(len(parts), 0, -1):
        with contextlib.suppress(ModuleNotFoundError):
            found = importlib.import_module(".".join(parts[:count]))
            break
    with contextlib.suppress(AttributeError):
        for part in parts[count:]:
            found = getattr(found, part)
        return True
    return False


@pytest.mark.parametrize("page", [page for page in PAGES if page.parent.name != "history"], ids=lambda page: page.name)
def test_what_a_page_names_of_the_code_is_there(page):
    text = page.read_text(encoding="utf-8")
    assert [name for name in NAME.findall(text) if not is_there(name)] == []
    assert [word for word in IDENTIFIER.findall(text) if word not in WORDS] == []
    named = [file for file in FILE.findall(text) if file not in FILES]
    assert [file for file in named if not any((folder / file).exists() for folder in (ROOT, page.parent))] == []


def test_the_pages_that_the_code_names_are_there():
    for source in SOURCES:
        for page in re.findall(r"docs/[\w/-]+\.md", source.read_text(encoding="utf-8")):
            assert (ROOT / page).exists(), f"{source.name}: {page}"


def test_no_page_names_a_folder_that_a_stranger_does_not_have():
    for page in PAGES:
        assert "../shared" not in page.read_text(encoding="utf-8"), page.name
