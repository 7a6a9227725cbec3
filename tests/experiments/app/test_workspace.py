"""The folder of the app: what a file may be called, and that nothing outside is a file of it."""

import shutil
import threading

import pytest
from hypothesis import given
from hypothesis import strategies as st

from experiments.app.names import MOST_BYTES, safe_name
from experiments.app.workspace import AppError, Workspace


@pytest.fixture
def workspace(tmp_path):
    return Workspace(tmp_path / "work")


@pytest.mark.parametrize(
    ("sent", "kept"),
    [
        ("lap 1.csv", "lap 1.csv"),
        ("Messung_Öl.csv", "Messung_Öl.csv"),
        ("../../etc/passwd", "passwd"),
        ("C:\\traces\\lap.csv", "lap.csv"),
        (".hidden.csv", "hidden.csv"),
        ("--out=x.csv", "out_x.csv"),
        ("<img src=x onerror=alert(1)>.csv", "_img src_x onerror_alert(1)_.csv"),
        ("a\nb\x1b[31m.csv", "a_b__31m.csv"),
        ("nul.csv", "_nul.csv"),
        ("", "file"),
        ("...", "file"),
    ],
)
def test_a_name_is_kept_as_far_as_it_is_one(sent, kept):
    assert safe_name(sent) == kept


@given(st.text(max_size=300))
def test_any_text_becomes_a_name_that_stays_itself_and_in_its_folder(text):
    name = safe_name(text)
    assert name == safe_name(name)
    assert 0 < len(name.encode()) <= MOST_BYTES
    assert not {"/", "\\", "\0", "\n", "<", '"', "'", "`", "$", "%", "&", "#", "?"} & set(name)
    assert name[0] not in ".-"
    assert name.isprintable()


def test_a_second_file_of_a_name_gets_a_number_and_the_first_stays(workspace):
    assert [workspace.add("lap.csv", text) for text in (b"1", b"2", b"3")] == ["lap.csv", "lap-2.csv", "lap-3.csv"]
    assert workspace.file("lap.csv").read_bytes() == b"1"


def test_two_that_send_one_name_at_once_get_a_file_each(workspace):
    threads = [threading.Thread(target=workspace.add, args=("lap.csv", b"%d" % k)) for k in range(20)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(workspace.names()) == 20
    assert {workspace.file(name).read_bytes() for name in workspace.names()} == {b"%d" % k for k in range(20)}


def test_what_is_not_sent_to_its_end_is_no_file(workspace):
    def send():
        with workspace.adding("lap.csv") as (file, _):
            file.write(b"half")
            raise ConnectionError

    with pytest.raises(ConnectionError):
        send()
    assert workspace.names() == []
    assert list(workspace.files.iterdir()) == []


OUTSIDE = ["/etc/passwd", "../secret", "files/../../secret", "files/.hidden", "jobs/../../secret", "files", "", "a\0b"]


@pytest.mark.parametrize("text", OUTSIDE)
def test_nothing_outside_is_a_file_of_the_workspace(workspace, text):
    (workspace.folder.parent / "secret").write_text("no")
    (workspace.files / ".hidden").write_text("no")
    with pytest.raises(AppError, match="there is no file"):
        workspace.path(text)


def test_a_link_that_leads_outside_is_no_file(workspace):
    secret = workspace.folder.parent / "secret"
    secret.write_text("no")
    (workspace.files / "lap.csv").symlink_to(secret)
    with pytest.raises(AppError):
        workspace.path("files/lap.csv")
    with pytest.raises(AppError):
        workspace.file("lap.csv")


def test_what_was_put_there_by_other_means_does_not_break_the_list(workspace):
    workspace.add("lap.csv", b"x")
    for name in ("a&b.csv", "--out.csv", ".hidden"):
        (workspace.files / name).write_text("x")
    (workspace.files / "link.csv").symlink_to(workspace.files / "lap.csv")
    (workspace.files / "folder").mkdir()
    assert workspace.names() == ["lap.csv"]
    assert all(workspace.file(name) for name in workspace.names())


def test_a_folder_that_was_deleted_is_said(workspace):
    assert workspace.is_there()
    shutil.rmtree(workspace.files)
    assert not workspace.is_there()
    assert "put it back" in workspace.gone


def test_a_broken_file_of_forms_is_an_empty_one(workspace):
    (workspace.folder / "forms.json").write_text("{")
    assert workspace.form("check") == {}
    workspace.keep_form("check", {"drive": "files/drive.toml"})
    assert Workspace(workspace.folder).form("check") == {"drive": "files/drive.toml"}


def test_a_folder_that_cannot_be_is_refused_in_one_line(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(AppError, match="name another folder"):
        Workspace(tmp_path / "file")
