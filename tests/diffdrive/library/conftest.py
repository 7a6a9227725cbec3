import platformdirs
import pytest

from diffdrive.library.search import FOLDERS


@pytest.fixture(autouse=True)
def own_folder(tmp_path, monkeypatch):
    """The user's configuration folder, which is empty here whatever the machine has."""
    monkeypatch.delenv(FOLDERS, raising=False)
    monkeypatch.setattr(platformdirs, "user_config_dir", lambda *_, **__: str(tmp_path / "config"))
    return tmp_path / "config" / "axes"
