"""A page of a report: what stands on it, what it leaves out, and that nothing that it quotes is obeyed."""

import base64
import hashlib
import json
import os
import re
import sys

import numpy as np
import pytest
from jinja2 import UndefinedError
from typer.testing import CliRunner

import diffdrive as dd
import experiments
from experiments.cli.main import app
from experiments.reports.page import built_in
from experiments.reports.page import page as page_module
from experiments.reports.page.chart import MOST_POINTS, Chart, Line, Panel, thinned
from experiments.reports.page.glossary import FILE, terms_in
from experiments.reports.page.plotly import figure, legend
from experiments.reports.page.sections import SECTIONS, page_section
from experiments.reports.page.table import MOST_ROWS, page_table
from experiments.reports.theme import new_figure
from tests.support import glossary
from tests.support.command_pages import COMMANDS, prepare
from tests.support.hostile_report import HOSTILE, filled, quiet, wave
from tests.support.page_rules import Page, assert_keeps_the_rules


@pytest.fixture(autouse=True)
def small_library(monkeypatch, request):
    """A word in the place of plotly.js, whose megabyte every test would read again; not where its size counts."""
    whole = page_module._asset
    if request.node.name != "test_charts_together_keep_a_page_small":
        monkeypatch.setattr(page_module, "_asset", lambda name: "0;" if name.startswith("plotly") else whole(name))


@pytest.mark.parametrize("text", HOSTILE, ids=range(len(HOSTILE)))
def test_nothing_that_a_page_quotes_is_obeyed(text, tmp_path):
    with quiet(text, tmp_path / "out") as report:
        filled(report, text)
    page = assert_keeps_the_rules(tmp_path / "out" / "report.html")
    assert len(page.all("script")) == 2 + 2  # plotly.js and the page's own; the data of two charts
    assert len(page.all("img")) == 1
    assert page.one("h1")["text"] == page_module.finalized(text)  # whole, braces and all
    assert " ".join(page_module.finalized(text).split()) in page.readable()
    data = [json.loads(one["text"]) for one in page.all("script") if "type" in one["attributes"]]
    for one in data:
        assert not any(set("<>") & set(trace["name"]) for trace in one["data"])


def test_a_file_of_any_name_is_linked_as_a_file_of_the_folder(tmp_path):
    names = ["javascript:alert(1).csv", "a b#c?d%41.csv", '"onload=.csv', "<b>.csv", "\u202ecsv.exe", "//host.csv"[2:]]
    with quiet("files", tmp_path) as report:
        report.say("it")
        for name in names:
            (tmp_path / name).write_text("x")
        (tmp_path / os.fsdecode(b"broken-\xff.csv")).write_text("x")
    page = assert_keeps_the_rules(tmp_path / "report.html")
    assert len([one for one in page.all("a") if "csv" in one["text"] or "exe" in one["text"]]) == len(names) + 1


def test_the_result_stands_first_then_the_contents_and_each_section_once(tmp_path):
    with quiet("a title", tmp_path) as report:
        report.say("The missing force is small.")
        report.conclude("The loop is stable.", good=True)
        filled(report, "text")
        report.page.good = True
    page = assert_keeps_the_rules(tmp_path / "report.html")
    headings = [one["text"] for one in page.all("h2")]
    assert headings == [
        "Result", "Contents", "Remarks", "Figures", "Tables", "Numbers", "Logs", "Files", "How it was made", "Terms",
    ]  # fmt: skip
    assert page.text.index("The loop is stable.") < page.text.index("Contents")
    linked = [one["text"] for one in page.all("a") if one["attributes"]["href"].startswith("#")][1:]
    assert linked == headings[2:]
    made = json.loads((tmp_path / "result.json").read_text())["made_by"]
    assert made["date"] in page.readable()
    assert f"diffdrive {made['diffdrive']}, jax {made['jax']}, python {made['python']}" in page.readable()


def test_what_was_stopped_says_so_first(tmp_path):
    def stopped():
        with quiet("stopped", tmp_path) as report:
            report.values("run", step=1)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        stopped()
    page = assert_keeps_the_rules(tmp_path / "report.html")
    assert "STOPPED: The command was interrupted. What it had found by then stands here." in page.readable()


def test_nothing_is_written_without_a_folder():
    with quiet("no folder", None) as report:
        filled(report, "text")


def test_long_tables_are_cut_and_say_where_the_rest_is(tmp_path):
    with quiet("long", tmp_path) as report:
        report.record("long", ("k", "value"), [[k, k / 7] for k in range(MOST_ROWS + 40)])
    page = assert_keeps_the_rules(tmp_path / "report.html")
    assert page.text.count("<tr>") == MOST_ROWS + 1
    assert "40 more rows are in the CSV file" in page.readable()


def test_a_table_that_is_recorded_and_shown_stands_once(tmp_path):
    with quiet("once", tmp_path) as report:
        report.record("gains", ("gain", "before"), [["kp", 1.0]])
        report.show("Gains", ("gain", "given"), [["kp", 1.0]], of="gains")
        report.table("margins", ("where", "phase deg"), [["held out", 40.0]])
    page = assert_keeps_the_rules(tmp_path / "report.html")
    assert [one["text"] for one in page.all("caption")] == ["Gains", "Margins"]
    assert [one["attributes"]["href"] for one in page.all("a") if "as CSV" in one["text"]] == [
        "./gains.csv", "./margins.csv",
    ]  # fmt: skip


def test_numbers_within_numbers_have_a_row_each(tmp_path):
    with quiet("numbers", tmp_path) as report:
        report.keep("result", rms_um=1.5, differences={"force": 1e-12, "load": 2.0}, lost={})
        report.keep("nothing", lost={})
        report.keep("history", search=[[[1, 0.5, 2.0], [2, 1.0, 1.0]]])  # a series is for programs
    page = assert_keeps_the_rules(tmp_path / "report.html")
    assert [one["text"] for one in page.all("td")] == [
        "RMS", "1.5", "µm", "differences: force", "1e-12", "", "differences: load", "2", "",
    ]  # fmt: skip


def test_what_is_words_alone_is_no_number(tmp_path):
    with quiet("words", tmp_path) as report:
        report.keep("run", status="ok")
        report.keep("written", file="a.toml", files=["a.toml", "b.csv"])
        report.keep("again", as_before=True)
    page = assert_keeps_the_rules(tmp_path / "report.html")
    assert [one["text"] for one in page.all("td")] == ["as before", "yes"]


def test_short_words_of_a_table_stay_in_a_line_and_sentences_get_room():
    cells = ["RMS error", "cascade without integral", "the table moves at one speed, most of the time"]
    table = page_table("widths", ("short", "phrase", "sentence", "number"), [[*cells, 1.0]])
    assert (table.words, table.phrases, table.wide) == ([1, 2, 3], [2, 3], [3])


def test_few_points_are_seen_as_symbols_and_ticks_have_no_prefix_of_a_unit():
    points = {n: Line(f"{n}", np.arange(n), np.arange(n), "points") for n in (5, 5000)}
    drawn = figure(Chart("points", [Panel("x", "force, N", list(points.values()))]))
    few, many = (trace["marker"]["size"] for trace in drawn["data"])
    assert few > 2 * many
    assert drawn["layout"]["yaxis"]["exponentformat"] == "power"


def test_pictures_beyond_what_a_page_may_hold_are_linked(tmp_path, monkeypatch):
    monkeypatch.setattr(built_in, "PICTURES", 30_000)
    with quiet("many", tmp_path) as report:
        for k in range(3):
            figure, axis = new_figure()
            axis.plot(np.random.default_rng(k).normal(size=300))
            report.figure(f"figure_{k}", figure)
    page = assert_keeps_the_rules(tmp_path / "report.html")
    assert len(page.all("img")) + page.text.count("no room for this picture") == 3
    assert "no room for this picture" in page.text


def test_a_picture_is_described_by_what_its_axes_say(tmp_path):
    with quiet("described", tmp_path) as report:
        figure, axis = new_figure()
        axis.plot([1, 2], label="given")
        axis.set(xlabel="time, s", ylabel="error, µm", title="search")
        report.figure("tuning", figure, "How it went.")
    page = assert_keeps_the_rules(tmp_path / "report.html")
    assert page.one("img")["attributes"]["alt"] == "How it went. search: error, µm over time, s: given."


@pytest.mark.parametrize("count", [10, MOST_POINTS, MOST_POINTS + 1, 100_003])
def test_a_thinned_line_keeps_its_peaks_its_ends_and_its_gaps(count):
    rng = np.random.default_rng(1)
    y = rng.normal(size=count)
    y[count // 2] = 50.0
    y[count // 3 : count // 3 + count // 20] = np.nan
    x, kept = thinned(Line("noise", np.arange(count), y))
    assert len(kept) <= MOST_POINTS + 2
    assert (np.nanmax(kept), np.nanmin(kept)) == (np.nanmax(y), np.nanmin(y))
    assert (x[0], x[-1]) == (0, count - 1)
    assert np.all(np.diff(x) > 0)
    np.testing.assert_array_equal(kept, y[x.astype(int)])
    assert np.isnan(kept).any() == np.isnan(y).any()


def test_lines_of_a_panel_never_look_alike_and_one_name_looks_the_same_everywhere():
    names = [f"line {k}" for k in range(30)]
    panels = [Panel("x", "y, N", [wave(name) for name in names]), Panel("x", "z, N", [wave("new"), wave("line 0")])]
    chart = Chart("many", panels)
    drawn = figure(chart)
    looks = [(trace["meta"], trace["line"]["dash"]) for trace in drawn["data"]]
    assert len(set(looks[:30])) == 30
    assert looks[31] == looks[0] != looks[30]
    first, second = legend(chart)
    assert [one["traces"] for one in first["entries"]] == [[0, 31], *([k] for k in range(1, 30))]
    assert [one["name"] for one in second["entries"]] == ["new"]
    assert drawn["layout"]["xaxis2"]["matches"] == "x"


def test_charts_together_keep_a_page_small(tmp_path):
    with quiet("many charts", tmp_path) as report:
        for k in range(40):
            report.chart(f"chart_{k}", Chart("c", [Panel("t", "y", [wave(f"{j}", 50_000) for j in range(8)])]))
        report.say("it")
    assert_keeps_the_rules(tmp_path / "report.html")


def test_terms_are_those_of_the_glossary_and_only_those_that_are_used():
    assert FILE.read_text(encoding="utf-8") == glossary.as_file(), "python -m tests.support.glossary"
    found = terms_in("Its command noise, and all missing\nforces")
    assert [one.term for one in found] == ["command", "command noise", "missing force"]
    assert terms_in("commander, uncommanded") == []


def test_a_section_of_ones_own_stands_where_it_says_and_is_escaped(tmp_path):
    @page_section("Wear", "<p>{{ hours }} h of service</p>", order=15)
    def wear(page):
        return {"hours": page.data["run"]["hours"]} if "run" in page.data else None

    try:
        for name, hours in (("with", "<b>1200</b>"), ("without", None)):
            with quiet(name, tmp_path / name) as report:
                report.say("it")
                if hours:
                    report.keep("run", hours=hours)
        page = assert_keeps_the_rules(tmp_path / "with" / "report.html")
        assert [one["text"] for one in page.all("h2")][2] == "Wear"
        assert "<b>1200</b> h of service" in page.readable()
        assert "Wear" not in (tmp_path / "without" / "report.html").read_text()
        with pytest.raises(dd.errors.ParameterError, match="there is one of this name"):
            page_section("Mine", "<p></p>", name="files")(wear)
    finally:
        SECTIONS.remove("wear")


def test_a_template_that_names_what_is_not_there_fails_and_leaves_the_numbers(tmp_path):
    page_section("Wrong", "{{ nothing }}", name="wrong")(lambda page: {})
    try:
        with pytest.raises(UndefinedError, match="'nothing' is undefined"), quiet("wrong", tmp_path) as report:
            report.say("it")
        assert json.loads((tmp_path / "result.json").read_text())["notes"] == ["it"]
    finally:
        SECTIONS.remove("wrong")


def test_a_result_in_python_has_the_page_that_the_command_writes(tmp_path):
    axis = dd.paper_axis()
    lap = dd.motion.triangular(speed=0.010, stroke=0.001, rounding=0.05, duration=0.2, rate=axis.rate)
    experiments.report(dd.simulate(axis, lap), tmp_path)
    page = assert_keeps_the_rules(tmp_path / "report.html")
    assert "Signals of the simulated run over time" in page.readable()
    [drawn] = [json.loads(one["text"]) for one in page.all("script") if "type" in one["attributes"]]
    assert {trace["name"] for trace in drawn["data"]} >= {"reference", "position", "command", "load"}
    assert "Command" not in [one["text"] for one in page.all("dt")]


def test_the_library_for_charts_is_the_one_that_is_named():
    [library] = (page_module.HERE / "assets").glob("plotly*.js")
    assert library.name == page_module.PLOTLY
    version = re.search(r"plotly.js \(basic - minified\) v(\S+)", library.read_text()[:200]).group(1)
    assert version in library.name
    assert not re.search(r"</script|<!--", library.read_text(), re.I)


def test_the_rules_notice_what_breaks_them():
    for broken in ("<p><b></p></b>", "</p>", "<p"):
        with pytest.raises(AssertionError):
            Page(f"<body>{broken}</body>")


def test_a_loop_that_runs_away_is_drawn_as_far_as_numbers_go():
    y = np.array([0.0, 1e-3, 1e60, np.inf, np.nan])
    [trace] = figure(Chart("away", [Panel("x", "y", [Line("away", np.arange(5), y)])]))["data"]
    assert trace["y"]["dtype"] == "f8"
    drawn = np.frombuffer(base64.b64decode(trace["y"]["bdata"]), "<f8")
    np.testing.assert_array_equal(drawn, [0.0, 1e-3, 1e60, np.nan, np.nan])


@pytest.mark.long
@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_writes_a_page_with_its_result_and_its_command(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    prepare(tmp_path)
    arguments = [*map(str, COMMANDS[name]), "--out", str(tmp_path / "out")]
    monkeypatch.setattr(sys, "argv", ["diffdrive", *arguments])
    assert CliRunner().invoke(app, arguments).exit_code == 0
    page = assert_keeps_the_rules(tmp_path / "out" / "report.html")
    assert f"diffdrive {name}" in page.one("code")["text"]
    if name in ("check", "start"):
        assert hashlib.sha256((tmp_path / "lap.csv").read_bytes()).hexdigest()[:16] in page.readable()
