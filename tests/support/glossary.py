"""The glossary of the documentation as data of the pages: `python -m tests.support.glossary` writes it again."""

import json
import re
from pathlib import Path

from experiments.reports.page.glossary import FILE

SOURCE = Path(__file__).resolve().parents[2] / "docs" / "reference" / "glossary.md"


def terms():
    """Term, meaning and unit of every row, without links and marks of Markdown."""
    rows = [line for line in SOURCE.read_text(encoding="utf-8").splitlines() if line.startswith("| ")]
    cells = [[plain(cell) for cell in line.strip("| ").split(" | ")] for line in rows]
    return [row[:3] for row in cells if len(row) == 4 and row[0] not in ("term", "---")]


def plain(cell):
    text = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", cell.strip())
    return re.sub(r"\*(\w[^*]*)\*", r"\1", text).replace("`", "")


def as_file():
    return json.dumps(terms(), ensure_ascii=False, indent=0) + "\n"


if __name__ == "__main__":
    FILE.write_text(as_file(), encoding="utf-8")
