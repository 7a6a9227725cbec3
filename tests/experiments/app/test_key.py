"""The key of a folder: its user alone can read it, and the folder is left as its user made it."""

import json
import os
import shutil
import stat

import pytest

from experiments.app.seal import Seal
from experiments.app.workspace import Workspace

server = pytest.importorskip("experiments.app.web.server", reason="needs the extra 'app'", exc_type=ImportError)
OWN = Seal(b"the secret of this user")
posix = pytest.mark.skipif(os.name == "nt", reason="Windows has no such permissions")


def mode(path):
    return stat.S_IMODE(path.stat().st_mode)


@pytest.fixture
def workspace(tmp_path):
    return Workspace(tmp_path / "work")


def test_a_key_lasts_with_the_port_of_the_last_time(workspace):
    key = server._key(workspace, 8123, OWN)
    assert server._key(workspace, 8124, OWN) == key
    assert json.loads((workspace.folder / "app.json").read_text())["port"] == 8124


def test_a_key_that_came_with_the_folder_is_made_anew(workspace, tmp_path):
    key = server._key(workspace, 8123, OWN)
    assert server._key(workspace, 8123, Seal(b"another's")) != key
    copy = Workspace(tmp_path / "copy")
    key = server._key(workspace, 8123, OWN)
    shutil.copy2(workspace.folder / "app.json", copy.folder / "app.json")
    assert server._key(copy, 8123, OWN) != key


@posix
@pytest.mark.parametrize("permissions", [0o644, 0o640, 0o604, 0o666])
def test_a_key_that_others_could_read_is_made_anew(workspace, permissions):
    key = server._key(workspace, 8123, OWN)
    path = workspace.folder / "app.json"
    assert mode(path) == 0o600
    path.chmod(permissions)
    assert server._key(workspace, 8123, OWN) != key
    assert mode(path) == 0o600


@posix
def test_a_key_is_not_written_through_a_link(workspace, tmp_path):
    outside = tmp_path / "outside.json"
    outside.write_text(json.dumps({"port": 1, "key": "k" * 43}))
    outside.chmod(0o600)
    (workspace.folder / "app.json").symlink_to(outside)
    key = server._key(workspace, 8123, OWN)
    assert key not in outside.read_text()
    assert key != "k" * 43
    assert not (workspace.folder / "app.json").is_symlink()


@pytest.mark.parametrize("kept", ["[", "[1]", "{}", '{"key": 5}', '{"key": "short"}'])
def test_what_is_no_key_is_replaced_by_one(workspace, kept):
    (workspace.folder / "app.json").write_text(kept)
    (workspace.folder / "app.json").chmod(0o600)
    server._listen(workspace, 0).close()
    assert len(server._key(workspace, 8123, OWN)) == 43


@posix
def test_a_folder_of_the_user_keeps_its_permissions_and_a_new_one_is_private(tmp_path):
    mine = tmp_path / "mine"
    mine.mkdir()
    mine.chmod(0o755)
    server._key(Workspace(mine), 8123, OWN)
    assert mode(mine) == 0o755
    assert mode(Workspace(tmp_path / "parent" / "new").folder) == 0o700
