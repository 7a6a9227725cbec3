"""The page in a browser: from a dropped trace to its verdict; with broken files, two tabs, and killed processes."""

import contextlib
import os
import time

import pytest
from typer.testing import CliRunner

from experiments.app.job import Job
from experiments.cli.main import app
from tests.support.app_page import choose, drop, press, text, until
from tests.support.app_server import AppServer
from tests.support.browser import WIDTHS, started, violations

pytest.importorskip("nicegui", reason="needs the extra 'app'")
pytestmark = [pytest.mark.long, pytest.mark.filterwarnings("ignore::ResourceWarning")]

SINE = "sine:amplitude=15mm,frequency=0.5Hz,duration=6s"
COGGING = '\n[effects.cogging]\nperiod = "2.5 mm"\ncosine = 3.0\nsine = 2.0\n'


@pytest.fixture(scope="module")
def example(tmp_path_factory):
    """The README's machine whose motor cogs, its log, and the drive file that does not know of it."""
    folder = tmp_path_factory.mktemp("example")
    drive, machine = folder / "drive.toml", folder / "machine.toml"
    drive.write_text(CliRunner().invoke(app, ["template"]).output, encoding="utf-8")
    machine.write_text(drive.read_text(encoding="utf-8") + COGGING, encoding="utf-8")
    line = ["simulate", str(drive), "--machine", str(machine), "--motion", SINE, "--out", str(folder / "lap")]
    assert CliRunner().invoke(app, line).exit_code == 0
    return folder


@pytest.fixture
def server(tmp_path):
    server = AppServer(tmp_path / "work")
    yield server
    server.end()


@pytest.fixture
def tab(server):
    driver = started()
    driver.get(server.url)
    yield driver
    try:
        errors = [one["message"] for one in driver.get_log("browser") if one["level"] == "SEVERE"]
        # while the app is down, and for a file that it refuses
        expected = ("ERR_CONNECTION_REFUSED", "WebSocket", "/take?", "favicon", "app.json", "beforeunload")
        assert [one for one in errors if not any(word in one for word in expected)] == []
    finally:
        driver.quit()


def ask(tab, server, command):
    """Press the button of a question on its tab of the first page, which is opened unless it is there."""
    if f"do={command}" not in tab.current_url:
        tab.get(f"{server.base}/?do={command}")
    ends = time.monotonic() + 30.0
    while "/run/" not in tab.current_url:
        for button in tab.find_elements("css selector", f"[data-run={command}]"):
            if button.is_displayed():
                button.click()
                break
        assert time.monotonic() < ends, text(tab)
        time.sleep(0.5)
    return Job(server.folder / "jobs" / tab.current_url.rpartition("/")[2])


def begun(tab, server, example):
    """A diagnosis that runs."""
    drop(tab, example / "drive.toml", example / "lap" / "run.csv")
    until(tab, "60,001 rows")
    job = ask(tab, server, "diagnose")
    until(tab, "recalibrating")
    return job


def test_a_dropped_trace_leads_to_its_verdict(tab, server, example):
    begun(tab, server, example)
    until(tab, "EFFECT: cogging explains the gap", 900.0)
    until(tab, "augmented.toml")
    frame = tab.find_element("tag name", "iframe")
    tab.switch_to.frame(frame)
    assert "cogging" in text(tab)
    tab.find_element("partial link text", "causes.png").click()  # of the files beside it
    assert "Open the address" not in tab.page_source
    tab.switch_to.default_content()
    tab.get(server.base)
    until(tab, "EFFECT: cogging explains the gap")


def test_a_name_that_a_script_made_up_is_text_and_a_folder_is_named(tab, server, tmp_path):
    until(tab, "Drop traces")
    names = [
        "../../x.csv",
        "a\"b'c.csv",
        "<script>document.title='hacked'<!--.csv",
        "n" * 300 + ".csv",
        "lap.csv",
        "lap.csv",
    ]
    tab.execute_script(
        "const data = new DataTransfer();"
        "for (const name of arguments[0]) data.items.add(new File(['a,b\\n1,2\\n'], name));"
        "for (const kind of ['dragenter', 'dragover', 'drop']) document.querySelector('.dd-drop').dispatchEvent("
        "new DragEvent(kind, {dataTransfer: data, bubbles: true, cancelable: true}))",
        names,
    )
    (tmp_path / "laps.csv").mkdir()
    drop(tab, tmp_path / "laps.csv")
    until(tab, "laps.csv: is a folder; drop the files in it")
    until(tab, "lap-2.csv")
    kept = {one.name for one in (server.folder / "files").iterdir()}
    assert {"x.csv", "a_b_c.csv", "lap.csv", "lap-2.csv"} < kept
    assert len(kept) == len(names)
    assert tab.title == "diffdrive"


def test_a_folder_that_is_taken_away_is_said_once_and_its_pages_go_on_when_it_is_back(tab, server, example):
    choose(tab, example / "drive.toml")
    until(tab, "3.33 kB")
    away = server.folder.with_name("away")
    server.folder.rename(away)
    until(tab, "is gone, or a part of it: put it back")
    time.sleep(3.0)
    assert text(tab).count("is gone") == 1
    drop(tab, example / "lap" / "run.csv")
    until(tab, "Dismiss")
    away.rename(server.folder)
    ends = time.monotonic() + 30.0
    while tab.find_elements("css selector", ".q-notification"):
        assert time.monotonic() < ends
        time.sleep(0.3)
    tab.refresh()
    until(tab, "3.33 kB")


def test_a_trace_alone_leads_to_a_drive_file_and_its_checks(tab, server, example):
    drop(tab, example / "lap" / "run.csv")
    until(tab, "60,001 rows")
    tab.get(f"{server.base}/?do=start")
    until(tab, "Moving mass")
    tab.find_element("css selector", "input[aria-label='Moving mass']").send_keys("100kg")
    ask(tab, server, "start")
    until(tab, "is a drive file for run.csv")
    until(tab, "drive.toml")
    ask(tab, server, "check")
    until(tab, "not fatal: the log can be used")


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_the_pages_are_legible_and_no_wider_than_the_screen(tab, server, example, scheme):
    drop(tab, example / "drive.toml", example / "lap" / "run.csv")
    until(tab, "60,001 rows")
    job = ask(tab, server, "check")
    until(tab, "the checks found nothing wrong")
    features = [{"name": "prefers-color-scheme", "value": scheme}]
    tab.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": features})
    pages = {
        "": "Questions",
        "/?do=compare": "Traces after",
        "/file/run.csv": "Save columns",
        "/file/drive.toml": "Save",
    }
    found = []
    for path, words in {**pages, f"/run/{job.id}": "the checks found nothing wrong"}.items():
        tab.get(server.base + path)
        until(tab, words)
        time.sleep(1.0)  # until it is drawn
        assert len(tab.find_elements("tag name", "main")) == 1
        for width in WIDTHS:
            screen = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": False}
            tab.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", screen)
            time.sleep(0.3)
            wide = "return document.documentElement.scrollWidth - document.documentElement.clientWidth"
            found += [(path, width, *one) for one in violations(tab)]
            found += [(path, width)] if tab.execute_script(wide) > 1 else []
    assert not found, "\n".join(map(str, found))


def test_columns_that_are_stated_go_along_and_outlast_a_reload(tab, server, tmp_path):
    rows = "".join(f"{0.001 * k:.3f},{k % 7},{k % 5}\n" for k in range(500))
    (tmp_path / "odd.csv").write_text(f"a,b,c\n{rows}")
    drop(tab, tmp_path / "odd.csv")
    until(tab, "odd.csv")
    tab.get(f"{server.base}/file/odd.csv")
    until(tab, "Save columns")
    for channel, column in (("position", "b"), ("command", "c")):
        tab.find_element("css selector", f"[aria-label='column of {channel}']").click()
        time.sleep(1.0)
        next(one for one in tab.find_elements("css selector", ".q-menu .q-item") if one.text == column).click()
        time.sleep(1.0)
    tab.find_element("css selector", "[aria-label='unit of position']").send_keys("mm")
    until(tab, "position, b: 0 to 6")
    press(tab, "Save columns")
    until(tab, "Kept. The commands take these columns")
    time.sleep(1.0)  # until it is drawn
    assert not violations(tab)
    tab.refresh()
    until(tab, "You stated these")


def test_a_wrong_file_is_said_in_one_line_and_its_name_is_text(tab, server, tmp_path, example):
    lap = (example / "lap" / "run.csv").read_bytes()
    (tmp_path / "noise.csv").write_bytes(os.urandom(100_000))
    (tmp_path / "photo.csv").write_bytes(b"\x89PNG\r\n\x1a\n" + os.urandom(10_000))
    (tmp_path / "cut.csv").write_bytes(lap[: len(lap) // 2])
    (tmp_path / "bad.toml").write_text("this = is [not toml")
    (tmp_path / "empty.csv").write_bytes(b"")
    (tmp_path / "<img src=x onerror=document.title='hacked'>.csv").write_bytes(lap[:200_000])
    (tmp_path / "photo.png").write_bytes(b"x")
    drop(tab, *(one for one in tmp_path.iterdir() if one.is_file()))
    for words in ("photo.png: is no trace", "empty.csv: is empty", "bad.toml: ", "noise.csv: ", "photo.csv: "):
        until(tab, words)
    until(tab, "onerror_document.title__hacked__.csv")
    until(tab, "cut.csv")
    assert tab.title == "diffdrive"
    for name in ("noise.csv", "bad.toml", "gone.csv", "..%2f..%2fapp.json"):
        tab.get(f"{server.base}/file/{name}")
        time.sleep(2.0)
        assert "Traceback" not in text(tab)
    tab.find_element("link text", "To the files and runs").click()
    until(tab, "Drop traces")


def test_two_tabs_do_not_overwrite_each_others_drive_file(tab, server, example):
    drop(tab, example / "drive.toml")
    until(tab, "3.33 kB")
    tab.get(f"{server.base}/file/drive.toml")
    until(tab, "100 kg")
    first = tab.current_window_handle
    tab.switch_to.new_window("tab")
    tab.get(f"{server.base}/file/drive.toml")
    for which, words in ((tab.current_window_handle, "Saved drive.toml"), (first, "was changed elsewhere")):
        tab.switch_to.window(which)
        until(tab, "100 kg")
        tab.find_element("tag name", "textarea").send_keys(f"\n# by {which}")
        press(tab, "Save")
        until(tab, words)
    text_kept = (server.folder / "files" / "drive.toml").read_text(encoding="utf-8")
    assert first not in text_kept
    assert "# by " in text_kept


def test_a_reload_while_a_file_is_sent_leaves_no_half_file(tab, server, tmp_path):
    with (tmp_path / "long.csv").open("wb") as file:
        file.truncate(1 << 30)
    until(tab, "Drop traces")
    tab.find_element("css selector", ".dd-drop input").send_keys(str(tmp_path / "long.csv"))
    files = server.folder / "files"
    ends = time.monotonic() + 30.0
    while not list(files.iterdir()):
        assert time.monotonic() < ends
        time.sleep(0.01)
    tab.execute_script("window.stop(); location.reload()")
    with contextlib.suppress(Exception):  # the question whether to leave
        tab.switch_to.alert.accept()
    until(tab, "No files yet")
    while list(files.iterdir()):
        assert time.monotonic() < ends
        time.sleep(0.1)


def test_two_tabs_show_the_same_and_either_stops_and_continues(tab, server, example):
    job = begun(tab, server, example)
    stop = tab.find_element("xpath", "//button[contains(., 'Stop')]")
    tab.execute_script("arguments[0].focus()", stop)
    time.sleep(3.0)
    assert tab.switch_to.active_element == stop  # the page has moved on, the focus has not
    first = tab.current_window_handle
    tab.switch_to.new_window("tab")
    tab.get(f"{server.base}/run/{job.id}")
    until(tab, "recalibrating")
    row = tab.find_element("xpath", "//button[contains(., 'Stop')]").rect
    press(tab, "Stop")
    until(tab, "it goes on from there", 60.0)
    after = tab.find_element("xpath", "//button[contains(., 'Continue')]").rect
    assert after["y"] >= row["y"] + row["height"]  # pressed once too often, Stop is not Continue
    tab.switch_to.window(first)
    until(tab, "it goes on from there")
    tab.refresh()
    until(tab, "it goes on from there")
    press(tab, "Continue")
    until(tab, "runs")
    job.process().kill()  # as where memory runs out
    until(tab, "ended from outside")
    press(tab, "Continue")
    until(tab, "recalibrating")
    assert job.state == "running"
    press(tab, "Stop")
    until(tab, "it goes on from there", 60.0)
    press(tab, "Delete")
    until(tab, "with its results?")
    assert "aria-dialog-name" not in dict(violations(tab))
    press(tab, "Keep")
    assert job.log.exists()  # a stop this early may leave no results yet


def test_a_killed_server_loses_nothing_and_its_pages_find_the_next_one(tab, server, example):
    job = begun(tab, server, example)
    pid = job.process().pid
    server.kill()
    assert job.state == "running"  # it is a process of its own
    server.start()
    until(tab, "screening", 300.0)  # in the page that was open
    assert job.process().pid == pid
    tab.get(server.base)
    until(tab, "60,001 rows")
    said = server.end()
    assert "asked to end" in said
    assert "Traceback" not in said
    ends = time.monotonic() + 30.0
    while job.state != "stopped":
        assert time.monotonic() < ends
        time.sleep(0.2)
    server.start()
    tab.get(f"{server.base}/run/{job.id}")
    until(tab, "Continue")


def test_a_trace_of_200_mb_is_taken_and_looked_at(tab, server, example, tmp_path):
    head, *rows = (example / "lap" / "run.csv").read_text(encoding="utf-8").splitlines(keepends=True)
    rest = [row.partition(",")[2] for row in rows[:-1]]
    with (tmp_path / "long.csv").open("w", encoding="utf-8") as file:
        file.write(head)
        lap = 0
        while file.tell() < 200e6:
            file.writelines(f"{6.0 * lap + 1e-4 * k:.4f},{row}" for k, row in enumerate(rest))
            lap += 1
    drop(tab, tmp_path / "long.csv")
    until(tab, "columns,", 600.0)
    assert (server.folder / "files" / "long.csv").stat().st_size == (tmp_path / "long.csv").stat().st_size
