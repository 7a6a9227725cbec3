"""What the site has beyond the pages of docs/: pages of the folder above, programs with their output, and links."""

import posixpath
import re
from pathlib import Path
from typing import Any

import executed
import listed
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File

ROOT = Path(__file__).resolve().parents[2]
ABOVE = {"CONTRIBUTING.md": "contributing.md", "CHANGELOG.md": "changelog.md"}
LINK = re.compile(r"(?<=\]\()([^)\s#]+)(?=[)#])")
FETCHED = re.compile(r'<(?:script|img|iframe)[^>]+src="(?:https?:)?//[^"]+|<link[^>]+href="(?:https?:)?//[^"]+')
_state = {"runs": True}


def on_startup(*, command: str, **_: Any) -> None:
    """Run programs where the site is built; who writes pages under `mkdocs serve` need not wait for them."""
    _state["runs"] = command == "build"


def on_files(files: Any, *, config: Any) -> Any:
    """Add what is not a page of docs/ as it stands."""
    for source, name in ABOVE.items():
        files.append(File.generated(config, name, content=(ROOT / source).read_text(encoding="utf-8")))
    for program in [file for file in files if file.src_uri.startswith("tutorials/notebooks/")]:
        files.remove(program)
        page = executed.notebook_page(Path(program.abs_src_path), run_it=_state["runs"])
        files.append(File.generated(config, re.sub(r"\.py$", ".md", program.src_uri), content=page.text))
        for name, content in page.files.items():
            files.append(File.generated(config, f"{posixpath.dirname(program.src_uri)}/{name}", content=content))
    for name, content in (executed.gallery_pictures() if _state["runs"] else {}).items():
        uri = f"figures/gallery/{name}"
        if kept := files.get_file_from_path(uri):
            files.remove(kept)
        files.append(File.generated(config, uri, content=content))
    return files


def on_page_markdown(markdown: str, *, page: Any, **_: Any) -> str:
    """Links as they work in the repository become links of the site; what the catalogues hold is listed."""
    uri = page.file.src_uri
    markdown = listed.listed(markdown) if uri.startswith("reference/api/") else markdown
    folder = "" if uri in ABOVE.values() else posixpath.join("docs", posixpath.dirname(uri))
    return LINK.sub(lambda link: linked(link[1], folder, uri), markdown)


def on_post_page(output: str, *, page: Any, **_: Any) -> str:
    """Refuse a page that a reader without a network would not see as it is."""
    if found := FETCHED.search(output):
        raise PluginError(f"{page.file.src_uri} fetches from a network: {found[0]}")
    return output


def linked(link: str, folder: str, page: str) -> str:
    """Where a link of a page leads in the site; `folder` is the page's in the repository."""
    if "://" in link:
        return link
    there = posixpath.normpath(posixpath.join(folder, link))
    if there in ABOVE:
        there = f"docs/{ABOVE[there]}"
    elif there.startswith("docs/tutorials/notebooks/"):
        there = re.sub(r"\.py$", ".md", there)
    elif folder:
        return link
    return posixpath.relpath(there.removeprefix("docs/"), posixpath.dirname(page) or ".")
