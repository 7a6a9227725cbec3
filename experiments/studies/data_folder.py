"""Where measured data lie: in `shared/data` beside this checkout or beside the working folder."""

from pathlib import Path


def find_data(name: str, file: str) -> Path | None:
    """The folder `name` of the data if it holds `file`, or None."""
    for place in (Path.cwd(), Path(__file__).resolve().parents[2]):
        folder = place.parent / "shared" / "data" / name
        if (folder / file).is_file():
            return folder
    return None
