"""The server: one for a workspace, on the loopback address, with the port and key that it had before."""

import contextlib
import json
import os
import secrets
import socket
import threading
import webbrowser
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import uvicorn
from fastapi import FastAPI
from filelock import FileLock, Timeout
from nicegui import app as pages
from nicegui import ui
from starlette.requests import Request
from starlette.responses import HTMLResponse, PlainTextResponse, Response
from starlette.staticfiles import StaticFiles

from experiments.app.jobs import Jobs
from experiments.app.private import is_private, user_secret, write_private
from experiments.app.seal import Seal
from experiments.app.web.guard import Guard, results_token
from experiments.app.web.home import home
from experiments.app.web.inspect import inspect
from experiments.app.web.layout import note_failure, page
from experiments.app.web.progress import progress
from experiments.app.web.routes import routes
from experiments.app.workspace import AppError, Workspace, read_json

HOST = "127.0.0.1"
LOCK = ".app.lock"
STATIC = Path(__file__).parent / "static"
GRACE = 2  # s that open connections get at the end
KEPT = "app.json"
NOWHERE = (
    '<!doctype html><html lang="en-GB" style="background: Canvas"><title>diffdrive</title>'
    '<meta name="viewport" content="width=device-width"><meta name="color-scheme" content="light dark">'
    '<main style="font: 16px sans-serif; margin: 2rem">'
    '<h1>There is no such page</h1><p><a href="/">To the files and runs</a></main></html>'
)
TICK = 0.5  # s, between two looks at what waits


def serve(workspace: Workspace, port: int, show: bool) -> None:
    """Serve the pages of a workspace until Ctrl-C; raises `AppError` where another app has it, or the port is taken."""
    with _alone(workspace), contextlib.closing(_listen(workspace, port)) as listening:
        workspace.clean()
        address = listening.getsockname()[1]
        seal = Seal(user_secret())
        key = _key(workspace, address, seal)
        jobs = Jobs(workspace, seal=seal)
        url = f"http://{HOST}:{address}/?key={key}"
        print(f"diffdrive app: {url}\nfolder: {workspace.folder}\nCtrl-C ends it", flush=True)
        ticket = secrets.token_urlsafe(32)
        if show:
            webbrowser.open(f"http://{HOST}:{address}/?key={ticket}")
        server = uvicorn.Server(
            uvicorn.Config(
                Guard(_application(jobs, f"/result/{results_token(key)}"), port=address, key=key, ticket=ticket),
                log_level="error",
                timeout_graceful_shutdown=GRACE,
                lifespan="on",
                server_header=False,
                proxy_headers=False,  # there is none before it: who says so is not believed
                ws_max_size=1 << 20,  # no message of a form is as long
            )
        )
        ended = threading.Event()
        ticking = threading.Thread(target=_tick, args=(jobs, ended), name="jobs", daemon=True)
        ticking.start()
        try:
            server.run(sockets=[listening])
        finally:
            ended.set()
            ticking.join()
            asked = jobs.leave()
            if asked:
                print(
                    f"{asked} running: asked to end; the page continues them when the app is started again", flush=True
                )


def _tick(jobs: Jobs, ended: threading.Event) -> None:
    """Start what waits, whether a page is open or not."""
    while not ended.wait(TICK):
        try:
            jobs.tick()
        except Exception as problem:  # a full disk, say: the next round may succeed
            note_failure(jobs.workspace, problem)


@contextlib.contextmanager
def _alone(workspace: Workspace) -> Iterator[None]:
    """Keep a second app out: both would start what waits."""
    lock = FileLock(workspace.folder / LOCK, timeout=0)
    try:
        lock.acquire()
    except Timeout:
        kept = _kept(workspace)
        where = f": http://{HOST}:{kept.get('port')}/?key={kept.get('key')}"
        raise AppError(f"the app runs already in this folder{where}, or name another --folder") from None
    try:
        yield
    finally:
        lock.release()


def _listen(workspace: Workspace, port: int) -> socket.socket:
    """A socket at the port; of 0 at that of the last time, so that open pages find it again, else at a free one."""
    kept = _kept(workspace)
    last = kept.get("port") if isinstance(kept.get("port"), int) else 0
    for one in [port] if port else [last, 0]:
        listening = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        if os.name != "nt":  # there it would let two programs have one port
            listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listening.bind((HOST, one))
            listening.listen()  # before the address is printed: who comes at once waits, and is not refused
            return listening
        except (OSError, OverflowError):
            listening.close()
    raise AppError(f"--port {port}: is taken, or not to be had; name another, or none")


def _key(workspace: Workspace, port: int, seal: Seal) -> str:
    """The key of the workspace, kept with the port where its user alone can read it; it lasts, and so does a bookmark.

    Where others could read it, or made it, it is made anew.
    """
    path, kept = workspace.folder / KEPT, _kept(workspace)
    key = str(kept.get("key"))
    if not is_private(path) or not seal.holds(kept.get("seal"), workspace.folder, key):
        key = secrets.token_urlsafe(32)
    write_private(path, json.dumps({"port": port, "key": key, "seal": seal.of(workspace.folder, key)}) + "\n")
    return key


def _kept(workspace: Workspace) -> dict[str, Any]:
    """The port and key of the last time."""
    kept = read_json(workspace.folder / KEPT)
    return kept if isinstance(kept, dict) else {}


def _application(jobs: Jobs, results: str) -> FastAPI:
    """The pages and routes."""
    application = FastAPI(openapi_url=None, docs_url=None, redoc_url=None)
    application.routes.extend(routes(jobs))
    application.mount("/static", StaticFiles(directory=STATIC), name="static")

    async def unexpected(request: Request, problem: Exception) -> Response:
        note_failure(jobs.workspace, problem)
        return PlainTextResponse("Something unexpected happened; app-log.txt in the folder of the app has it.", 500)

    def built(build: Callable[[], None]) -> None:
        if jobs.workspace.is_there():
            build()
            return
        with page("diffdrive", home=True):
            ui.label(jobs.workspace.gone).classes("dd-bad dd-says")

    async def nowhere(request: Request, problem: Exception) -> Response:
        return HTMLResponse(NOWHERE, 404)

    async def first(do: str = "") -> None:
        built(lambda: home(jobs, do))

    async def of_file(name: str) -> None:
        built(lambda: inspect(jobs, name))

    async def of_run(name: str) -> None:
        built(lambda: progress(jobs, name, results))

    application.add_exception_handler(Exception, unexpected)
    for path, build in (("/", first), ("/file/{name}", of_file), ("/run/{name}", of_run)):
        ui.page(path, title="diffdrive")(
            build
        )  # no decorator: without the framework's types it would be an untyped one
    pages.add_exception_handler(404, nowhere)  # in the place of the framework's, which leads nowhere
    pages.on_exception(lambda problem: note_failure(jobs.workspace, problem))
    ui.run_with(application, title="diffdrive", language="en-GB", dark=None, show_welcome_message=False)
    return application
