"""What is sent and fetched beside the pages: dropped files, results, and nothing else of the disk."""

import errno
import shutil
from typing import Any
from urllib.parse import unquote

from starlette.requests import ClientDisconnect, Request
from starlette.responses import FileResponse, PlainTextResponse, Response
from starlette.routing import Route

from diffdrive.support.atomic_write import NO_SPACE
from diffdrive.support.messages import printable, shortened
from experiments.app.jobs import Jobs
from experiments.app.names import safe_name
from experiments.app.result import REPORT, file_of
from experiments.app.workspace import DRIVE_FILE, AppError

SPARE = 100 << 20  # bytes that stay free on the disk: results, and the system, need some
# a report may run its own scripts, and reach nothing: no address, no cookie, no page of ours
SEALED = (
    "sandbox allow-scripts allow-downloads; default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; "
    "img-src data:; font-src data:; frame-ancestors 'self'"
)
SHOWN = {".png": "image/png", ".svg": "image/svg+xml"}  # in the page; all else is saved


def known_endings() -> list[str]:
    """The extensions of files that the app takes."""
    from diffdrive.logs.formats.registry import READERS

    return [*sorted(READERS), DRIVE_FILE]


def routes(jobs: Jobs) -> list[Route]:
    """The addresses beside the pages."""
    workspace = jobs.workspace

    async def take(request: Request) -> Response:
        """A file that was dropped: its bytes are the body, its name is in the address."""
        name = safe_name(unquote(request.query_params.get("name", "")))
        ending = "." + name.rpartition(".")[2].casefold() if "." in name else ""
        if ending not in known_endings():
            return _says(415, f"{name}: is no trace and no drive file; those end in {', '.join(known_endings())}")
        size = int(length) if (length := request.headers.get("content-length", "")).isdigit() else 0
        if not workspace.is_there():
            return _says(500, workspace.gone)
        if shutil.disk_usage(workspace.files).free < size + SPARE:
            return _says(507, f"{name}: there is no room on the disk for it; make some, or use another --folder")
        try:
            with workspace.adding(name) as (file, given):
                received = 0
                async for chunk in request.stream():
                    file.write(chunk)
                    received += len(chunk)
                if not received:
                    raise AppError(f"{name}: is empty; export it again")
        except ClientDisconnect:  # the tab was closed: half a trace is no trace
            return _says(400, f"{name}: was not sent to its end")
        except AppError as problem:
            return _says(400, str(problem))
        except OSError as problem:
            if problem.errno in NO_SPACE or problem.errno == errno.EFBIG:
                return _says(507, f"{name}: there is no room on the disk for it; make some, or use another --folder")
            return _says(500, f"{name}: cannot be kept ({problem.strerror})")
        jobs.look(given[0])
        return PlainTextResponse(given[0])

    async def result(request: Request) -> Response:
        """A file of a job: a report in a sandbox, a figure, or a download."""
        try:
            path = file_of(jobs.get(request.path_params["job"]), request.path_params["name"])
        except AppError as problem:
            return _says(404, str(problem))
        kept: dict[str, Any] = {"headers": {"cache-control": "no-cache"}}
        if "download" not in request.query_params:
            if path.name == REPORT:
                return FileResponse(path, media_type="text/html", headers={"content-security-policy": SEALED})
            if path.suffix in SHOWN:
                headers = {"content-security-policy": "default-src 'none'; style-src 'unsafe-inline'; sandbox"}
                return FileResponse(path, media_type=SHOWN[path.suffix], headers=headers | kept["headers"])
        return FileResponse(path, filename=path.name, media_type="application/octet-stream", **kept)

    async def log(request: Request) -> Response:
        """What a job printed, as it stands."""
        try:
            job = jobs.get(request.path_params["job"])
        except AppError as problem:
            return _says(404, str(problem))
        return FileResponse(job.log, filename=f"{job.id}.txt", media_type="application/octet-stream")

    return [
        Route("/take", take, methods=["POST"]),
        Route("/result/{token}/{job}/log", log),
        Route("/result/{token}/{job}/out/{name:path}", result),
    ]


def _says(code: int, text: str) -> Response:
    return PlainTextResponse(shortened(printable(text), 400), status_code=code)
