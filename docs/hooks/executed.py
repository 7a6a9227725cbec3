"""Pages that are programs: run at each build, so that what a page shows is what its code does.

A notebook (`tutorials/notebooks/*.py`, a cell after each `# %%`) becomes a page with the output of its cells, beside
the notebook itself to download. The gallery's blocks save their pictures, which take the place of those kept for who
reads the page without building it. `python docs/hooks/executed.py` brings the kept ones up to date.
"""

import os
import shutil
import tempfile
from pathlib import Path
from typing import Any, NamedTuple

DOCS = Path(__file__).resolve().parents[1]
NOTEBOOKS = DOCS / "tutorials" / "notebooks"
GALLERY, PICTURES = DOCS / "gallery.md", DOCS / "figures" / "gallery"
LONGEST = 600  # s that a cell may take


class Executed(NamedTuple):
    """A program that was run: its page, and the files that the page shows or offers, by name."""

    text: str
    files: dict[str, bytes]


def read(path: Path) -> Any:
    """The notebook that a page of code, or a program with cells, is."""
    import jupytext
    import nbformat

    notebook = jupytext.read(path)
    notebook.metadata["kernelspec"] = {"name": "python3", "display_name": "Python 3", "language": "python"}
    return nbformat.from_dict(notebook)


def run(notebook: Any, folder: Path) -> Any:
    """The notebook with the output of its cells, run in a folder; raises `CellExecutionError` where one fails."""
    from nbclient import NotebookClient

    env = {**os.environ, "TF_CPP_MIN_LOG_LEVEL": "3"}  # on a busy machine the compiler says how slow it is
    where = {"metadata": {"path": str(folder)}}
    # what a cell prints is one block, however long the pauses between its lines
    return NotebookClient(notebook, timeout=LONGEST, resources=where, coalesce_streams=True).execute(env=env)


def notebook_page(path: Path, *, run_it: bool = True) -> Executed:
    """A notebook as Markdown with its output, if it is run; its pictures, and itself to download."""
    import nbformat
    from nbconvert import MarkdownExporter

    notebook = read(path)
    source = nbformat.writes(notebook)
    if run_it:
        with tempfile.TemporaryDirectory() as folder:
            notebook = run(notebook, Path(folder))
    exporter = MarkdownExporter()
    page, resources = exporter.from_notebook_node(notebook, {"unique_key": path.stem, "output_files_dir": "."})
    title, _, rest = page.lstrip().partition("\n")
    offer = f"[Download this notebook]({path.stem}.ipynb); its output is that of the build of these pages.\n"
    files = {Path(name).name: content for name, content in resources.get("outputs", {}).items()}
    return Executed(f"{title}\n\n{offer}{rest}", files | {f"{path.stem}.ipynb": source.encode()})


def gallery_pictures() -> dict[str, bytes]:
    """The pictures that the gallery's blocks save, by name."""
    with tempfile.TemporaryDirectory() as folder:
        run(read(GALLERY), Path(folder))
        return {path.name: path.read_bytes() for path in sorted(Path(folder).glob("*.png"))}


def main() -> None:
    """Bring the kept pictures of the gallery up to date."""
    shutil.rmtree(PICTURES, ignore_errors=True)
    PICTURES.mkdir(parents=True)
    for name, content in gallery_pictures().items():
        (PICTURES / name).write_bytes(content)


if __name__ == "__main__":
    main()
