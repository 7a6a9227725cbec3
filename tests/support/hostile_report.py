"""Reports that quote what a file may hold at its worst, in every place that can quote a file."""

import numpy as np
from rich.console import Console

from experiments.reports.page.chart import Chart, Line, Panel
from experiments.reports.report import Report
from experiments.reports.theme import new_figure

HOSTILE = [
    "<script>window.ran = 1</script>",
    "<img src=x onerror=window.ran=1>",
    '" onload="window.ran=1" x="',
    "' onfocus='window.ran=1' autofocus x='",
    "{{7*7}}{% for k in range(9) %}x{% endfor %}{{ self.__class__ }}",
    "</title></style></script><script>window.ran=1</script>",
    "<!-- --><!--<script>",
    "javascript:window.ran=1",
    "%{customdata}<b>$\\alpha$</b><a href='javascript:window.ran=1'>x</a>",
    "\u202eevil\u202c \u05d0\u05d1 \u0639\u0631",
    "bell\a null\0 escape\x1b[31m line\nend\u2028 tab\t del\x7f c1\x9b",
    "broken \udcff\udc80",
    "long" * 400,
    "&lt;script&gt; &amp;amp; &#x3c;",
]


def quiet(title, out):
    return Report(title, out, Console(quiet=True))


def wave(name="wave", count=50):
    time = np.linspace(0.0, 1.0, count)
    return Line(name, time, np.sin(20.0 * time))


def filled(report, text, name="plain"):
    """Everything that a report can hold, with this text in every place that can quote a file."""
    report.conclude(text, verdict=text, good=False)
    report.say(text)
    report.values("numbers", **{text: 1.0, "text": text, "rms_um": 2.0})
    report.keep(text, value=text)
    if "\udcff" not in text:  # of which no CSV file can be written
        rows = [[text, 1.0, None], ["b", 2.0, text]]
        report.table(name, (text, f"{text}, um", f"RMS {text}"), rows, text, notes=[text])
        report.record(f"{name}_2", (text, "value"), [[text, 1]])
    report.show(text, (text,), [[text]])
    figure, axis = new_figure()
    axis.plot([0, 1], label="line")
    report.figure(name, figure, text)
    axis.set(xlabel=text.replace("$", ""))
    report.chart(name, Chart(text, [Panel(text, f"{text}, N", [wave(text), wave(f"{text} 2")])]))
    report.chart("alone", Chart(text, [Panel(text, text, [wave(text)])]))
    report.page.logs.append({"log": text, text: text})
    report.data["made_by"]["arguments"] = ["simulate", text]
    report.data["timings_s"] = {text: 1.0}
