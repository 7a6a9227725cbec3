"""The diagnosis as one self-contained HTML page that a colleague can open."""

import base64
from html import escape
from typing import Any

from experiments.report import Report
from tuning.diagnosis.where import SIGNIFICANT

STYLE = """
body { font-family: sans-serif; max-width: 60rem; margin: 2rem auto; padding: 0 1rem; color: #222; line-height: 1.4 }
h1 { font-size: 1.5rem } h2 { font-size: 1.15rem; margin-top: 2rem; border-bottom: 1px solid #ccc }
table { border-collapse: collapse } td, th { padding: .2rem .7rem; text-align: right; border-bottom: 1px solid #eee }
td:first-child, th:first-child { text-align: left } img { max-width: 100% }
.verdict { font-size: 1.15rem; padding: .7rem 1rem; background: #eef4fb; border-left: 4px solid #1f77b4 }
"""
REGIONS = 10


def page(report: Report, told: dict[str, Any], augmented: str | None) -> None:
    """Write report.html beside the figures, which it holds inside."""
    assert report.out is not None
    gap, title = told["gap"], escape(report.data["title"])
    where = [one for one in told["where"] if one["p_value"] < SIGNIFICANT][:REGIONS]
    parts = [
        f"<!doctype html><html lang='en'><meta charset='utf-8'><title>{title}</title><style>{STYLE}</style>",
        f"<h1>{title}</h1>",
        f"<p class='verdict'><b>{told['verdict'].upper()}</b>: {escape(told['says'])}</p>",
        "<h2>1. How large is the gap?</h2>",
        f"<p>RMS of simulation against log, {escape(gap['judged_on'])}.</p>",
        _table(
            ("model", "missing force, N", "95 %", "position, um", "command, N"),
            [*[_ladder_row(one) for one in told["ladder"]], _floor_row(gap)],
        ),
        _image(report, "ladder"),
        "<h2>2. Where does it lie?</h2>",
        "<ul>" + "".join(f"<li>{escape(one['says'])} (p = {one['p_value']:.2g})</li>" for one in where) + "</ul>"
        if where
        else "<p>No region has more of it than chance would give it.</p>",
        _image(report, "where"),
        "<h2>3. Which unmodelled effect causes it?</h2>",
        _table(
            ("effect", "confidence", "parameters with 95 % intervals", "not excluded in its place"),
            [_cause_row(one) for one in told["causes"]],
        ),
        _image(report, "causes"),
        "<h2>4. How far does the gap shrink once it is added?</h2>",
        _image(report, "missing_force"),
        f"<p>Drive with what was found: <code>{escape(augmented)}</code></p>" if augmented else "",
        f"<h2>What next?</h2><p>{escape(told['next_experiment']['says'])}</p>",
        "</html>",
    ]
    (report.out / "report.html").write_text("\n".join(parts), encoding="utf-8")


def _image(report: Report, name: str) -> str:
    assert report.out is not None
    path = report.out / f"{name}.png"
    if not path.exists():
        return ""
    data = base64.b64encode(path.read_bytes()).decode("ascii")
    return f"<img alt='{name}' src='data:image/png;base64,{data}'>"


def _table(columns: tuple[str, ...], rows: list[list[str]]) -> str:
    head = "".join(f"<th>{escape(one)}</th>" for one in columns)
    body = "".join("<tr>" + "".join(f"<td>{escape(one)}</td>" for one in row) + "</tr>" for row in rows)
    return f"<table><tr>{head}</tr>{body}</table>"


def _number(value: Any, scale: float = 1.0) -> str:
    return "-" if value is None else f"{scale * value:.3g}"


def _ladder_row(one: dict[str, Any]) -> list[str]:
    low, high = one["force_interval_N"]
    return [
        one["model"],
        _number(one["force_rms_N"]),
        f"{low:.3g} to {high:.3g}",
        _number(one["position_rms_m"], 1e6),
        _number(one["command_rms_N"]),
    ]


def _floor_row(gap: dict[str, Any]) -> list[str]:
    return [
        "noise floor",
        _number(gap["noise_floor_force_N"]),
        "",
        _number(gap["noise_floor_position_m"], 1e6),
        _number(gap["noise_floor_command_N"]),
    ]


def _cause_row(one: dict[str, Any]) -> list[str]:
    return [
        one["effect"],
        f"{one['confidence']:.2f}",
        "; ".join(_parameter(name, one) for name in one["parameters"]) if one["found"] else "",
        ", ".join(one["indistinguishable_from"]),
    ]


def _parameter(name: str, cause: dict[str, Any]) -> str:
    value, (low, high), unit = cause["parameters"][name], cause["intervals"][name], cause["units"][name]
    if isinstance(value, list):
        value, low, high = value[0], low[0], high[0]
    return f"{name} {value:.4g} ({low:.4g} to {high:.4g}){'' if unit == '1' else ' ' + unit}"
