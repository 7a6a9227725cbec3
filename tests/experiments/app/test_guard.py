"""Who may ask, and what is sent: no other site, no other user, no file beside the results."""

import asyncio
import errno
import importlib.util
import os
import shutil
import socket

import pytest
from typer.testing import CliRunner

from diffdrive.errors import ParameterError
from experiments.app.jobs import Jobs
from experiments.app.web.guard import Guard, results_token
from experiments.app.workspace import AppError, Workspace, write_json
from experiments.cli.main import app

KEY = "k" * 43
OURS = {"host": "127.0.0.1:8123", "cookie": f"diffdrive-8123={KEY}"}


def answer(headers, *, kind="http", path="/", query="", method="GET", port=8123):
    """The first message that comes back, and whether the application was asked."""
    asked, sent = [], []

    async def application(scope, receive, send):
        asked.append(scope)
        if kind == "http":
            await send({"type": "http.response.start", "status": 200, "headers": []})

    async def send(message):
        sent.append(message)

    scope = {"type": kind, "path": path, "query_string": query.encode(), "method": method}
    scope["headers"] = [(name.encode(), value.encode()) for name, value in headers.items()]
    asyncio.run(Guard(application, port=port, key=KEY)(scope, None, send))
    return (sent[0] if sent else {}), bool(asked)


def test_a_page_of_ours_is_answered_and_may_load_nothing_from_elsewhere():
    message, asked = answer(OURS)
    headers = dict(message["headers"])
    assert asked
    assert message["status"] == 200
    assert b"default-src 'self'" in headers[b"content-security-policy"]
    assert b"http" not in headers[b"content-security-policy"].replace(b"ws://127.0.0.1:8123 ws://localhost:8123", b"")


@pytest.mark.parametrize(
    "changed",
    [
        {"host": "evil.example:8123"},  # a name that leads to this machine
        {"host": "127.0.0.1:9999"},
        {"host": ""},
        {"origin": "http://evil.example"},
        {"origin": "http://127.0.0.1:9999"},
        {"origin": "null"},  # of a report in its sandbox
        {"cookie": ""},
        {"cookie": "diffdrive-8123=wrong"},
        {"cookie": f"diffdrive-9999={KEY}"},
        {"cookie": "\x00;;=\xff"},
    ],
)
@pytest.mark.parametrize(("kind", "method"), [("http", "GET"), ("http", "POST"), ("websocket", "GET")])
def test_whoever_else_asks_is_refused(changed, kind, method):
    message, asked = answer(OURS | changed, kind=kind, method=method)
    assert not asked
    assert message.get("status") == 403 or message["type"] == "websocket.close"


def test_the_port_that_browsers_leave_out_is_ours_as_well():
    ours = {"host": "localhost", "origin": "http://localhost", "cookie": f"diffdrive-80={KEY}"}
    assert answer(ours, port=80)[1]
    assert not answer(ours | {"origin": "http://localhost:8123"}, port=80)[1]
    assert not answer(OURS | {"host": "127.0.0.1"})[1]


def test_the_printed_address_lets_in_and_its_key_leaves_the_address():
    message, asked = answer({"host": OURS["host"]}, path="/run/0001-check", query=f"key={KEY}")
    headers = dict(message["headers"])
    assert (message["status"], headers[b"location"], asked) == (303, b"/run/0001-check", False)
    assert b"HttpOnly; SameSite=Strict" in headers[b"set-cookie"]


@pytest.mark.parametrize("path", ["//evil.example/", "/\\evil.example", "/\\/evil.example", "/\\\\//\\evil.example"])
def test_the_printed_address_leads_nowhere_else(path):
    message, _ = answer({"host": OURS["host"]}, path=path, query=f"key={KEY}")
    assert dict(message["headers"])[b"location"] == b"/evil.example" + (b"/" if path.endswith("/") else b"")


@pytest.mark.parametrize(
    ("path", "query", "location"),
    [
        ("/file/üï.csv", "key={key}", "/file/%C3%BC%C3%AF.csv"),
        ("/file/a b%?#&.csv", "key={key}", "/file/a%20b%25%3F%23%26.csv"),
        ("/a\\..\\b", "key={key}", "/a%5C..%5Cb"),
        ("/\t/evil.example", "key={key}", "/%09/evil.example"),
        ("/a\r\nb: c", "key={key}", "/a%0D%0Ab%3A%20c"),
        ("/", "do=check&key={key}", "/?do=check"),
        ("/", "key={key}&do=check&empty=&x=%C3%BC%26", "/?do=check&empty=&x=%C3%BC%26"),
    ],
)
def test_the_printed_address_leads_to_the_very_page(path, query, location):
    message, _ = answer({"host": OURS["host"]}, path=path, query=query.replace("{key}", KEY))
    assert dict(message["headers"])[b"location"].decode() == location


@pytest.mark.parametrize("query", ["key=wrong", "key=", "", "key=%ff", f"key={KEY}&key=x"[:20]])
def test_a_wrong_key_lets_nobody_in(query):
    message, asked = answer({"host": OURS["host"]}, query=query)
    assert (message["status"], asked) == (403, False)


def test_what_a_report_links_is_sent_without_a_cookie_and_only_that():
    host, path = {"host": OURS["host"]}, f"/result/{results_token(KEY)}/0001-check/out/logs.csv"
    assert answer(host, path=path)[1]
    assert answer(host | {"origin": "null"}, path=path)[1]
    assert not answer({"host": "evil.example"}, path=path)[1]
    assert not answer(host, path=path, method="POST")[1]
    assert not answer(host, path=path, kind="websocket")[1]
    assert not answer(host, path="/result/t/0001-check/out/logs.csv")[1]
    assert KEY not in path


def test_a_ticket_lets_in_once():
    async def application(scope, receive, send):
        pass

    guard = Guard(application, port=8123, key=KEY, ticket="t" * 43)
    codes = []

    async def send(message):
        if "status" in message:
            codes.append(message["status"])

    scope = {"type": "http", "path": "/", "method": "GET", "query_string": b"key=" + b"t" * 43}
    for _ in range(2):
        asyncio.run(guard(scope | {"headers": [(b"host", b"127.0.0.1:8123")]}, None, send))
    assert codes == [303, 403]


@pytest.fixture
def client(tmp_path, monkeypatch):
    starlette = pytest.importorskip("starlette.testclient", reason="needs the extra 'app'")
    from starlette.applications import Starlette

    from experiments.app.web.routes import routes

    jobs = Jobs(Workspace(tmp_path / "work"))
    monkeypatch.setattr(jobs, "look", lambda name: None)  # reads no file here
    job = jobs.workspace.jobs / "0001-check"
    (job / "out" / ".hidden").mkdir(parents=True)
    write_json(job / "job.json", {"arguments": ["check"], "wanted": "stop"})
    for name in ("report.html", "causes.png", "logs.csv", ".hidden/part"):
        (job / "out" / name).write_text("<script>1</script>")
    (job / "out" / "link.csv").symlink_to(job / "job.json")
    with starlette.TestClient(Starlette(routes=routes(jobs))) as client:
        client.jobs = jobs
        yield client


def test_a_report_is_shown_in_a_sandbox_and_all_else_saved(client):
    report = client.get("/result/t/0001-check/out/report.html")
    assert report.headers["content-security-policy"].startswith(
        "sandbox allow-scripts allow-downloads; default-src 'none'"
    )
    assert "attachment" in client.get("/result/t/0001-check/out/report.html?download").headers["content-disposition"]
    table = client.get("/result/t/0001-check/out/logs.csv")
    assert table.headers["content-type"] == "application/octet-stream"
    assert "attachment" in table.headers["content-disposition"]


@pytest.mark.parametrize(
    "path",
    [
        "0001-check/out/..%2fjob.json", "0001-check/out/%2e%2e/job.json", "0001-check/out/link.csv", "..%2fwork/log",
        "0001-check/out/.hidden/part", "0001-check/out//etc/passwd", "0001-check/out/a%00b", "0002-check/out/x",
        "0001-check/out/", "%2e%2e/out/x", "..%2f..%2fjobs%2f0001-check/out/logs.csv",
    ],
)  # fmt: skip
def test_nothing_beside_the_results_is_sent(client, path):
    assert client.get(f"/result/t/{path}").status_code == 404


@pytest.mark.parametrize(
    ("name", "content", "code", "says"),
    [
        ("photo.png", b"x", 415, "is no trace and no drive file"),
        ("noending", b"x", 415, "is no trace and no drive file"),
        ("empty.csv", b"", 400, "is empty"),
        ("%2e%2e%2f%2e%2e%2fx.csv", b"x", 200, "x.csv"),
        ("%3Cb%3E.csv", b"x", 200, "_b_.csv"),
        ("LAP.CSV", b"x", 200, "LAP.CSV"),
    ],
)
def test_a_file_is_taken_by_its_ending_or_refused_in_one_line(client, name, content, code, says):
    sent = client.post(f"/take?name={name}", content=content)
    assert (sent.status_code, "\n" in sent.text) == (code, False)
    assert says in sent.text
    assert client.jobs.workspace.names() == ([sent.text] if code == 200 else [])


def test_a_file_for_a_folder_that_is_gone_is_refused_in_one_line(client):
    shutil.rmtree(client.jobs.workspace.folder)
    sent = client.post("/take?name=lap.csv", content=b"x")
    assert (sent.status_code, "is gone" in sent.text) == (500, True)
    assert client.jobs.leave() == 0


def test_a_disk_that_fills_up_leaves_no_half_file(client, monkeypatch):
    def full(_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    sent = client.post("/take?name=lap.csv", content=b"x" * 1000)
    assert (sent.status_code, "no room" in sent.text) == (507, True)
    assert list(client.jobs.workspace.files.iterdir()) == []


def test_a_file_for_which_there_is_no_room_is_refused_before_it_is_sent(client, monkeypatch):
    monkeypatch.setattr(shutil, "disk_usage", lambda _: shutil._ntuple_diskusage(1, 1, 0))
    sent = client.post("/take?name=lap.csv", content=b"x")
    assert sent.status_code == 507
    assert "no room" in sent.text


def test_a_port_that_is_taken_is_refused_in_one_line(tmp_path):
    server = pytest.importorskip("experiments.app.web.server", reason="needs the extra 'app'", exc_type=ImportError)
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        with pytest.raises(AppError, match=f"--port {port}: is taken"):
            server._listen(Workspace(tmp_path), port)
        write_json(tmp_path / "app.json", {"port": port})
        with server._listen(Workspace(tmp_path), 0) as free:  # that of the last time is another program's by now
            assert free.getsockname()[0] == "127.0.0.1"
            assert free.getsockname()[1] != port


def test_without_the_extra_the_command_says_what_to_install(monkeypatch, tmp_path):
    found = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name, *more: None if name == "nicegui" else found(name, *more)
    )
    ran = CliRunner().invoke(app, ["app", "--no-show", "--folder", str(tmp_path / "work")])
    assert isinstance(ran.exception, ParameterError)
    assert "pip install 'diffdrive[app]'" in str(ran.exception)
    assert not (tmp_path / "work").exists()
