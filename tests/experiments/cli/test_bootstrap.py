"""The set-up script: which Python it picks, and that it starts on an old one."""

import ast
import importlib.util
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).resolve().parents[3] / "experiments" / "bootstrap.py"


@pytest.fixture
def bootstrap():
    """The script as a module; nothing in the project may import it, so it is loaded by its path."""
    spec = importlib.util.spec_from_file_location("bootstrap_under_test", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def stub(folder, name, version=(3, 13, 0, "final", 0), implementation="cpython", is_64_bit=True, without_gil=False):
    """A program that answers the script's question as such an interpreter would."""
    folder.mkdir(exist_ok=True)
    path = folder / name
    answer = json.dumps([list(version), implementation, is_64_bit, str(path), "x86_64", without_gil])
    path.write_text(f"#!/bin/sh\necho '{answer}'\n")
    path.chmod(0o755)
    return path


def broken(folder, name, text="exit 127"):
    """What a pyenv shim of a version that is not switched on does."""
    path = stub(folder, name)
    path.write_text(f"#!/bin/sh\n{text}\n")
    return path


def chosen(bootstrap, *folders):
    paths = bootstrap.pythons_on_path(os.pathsep.join(map(str, folders)))
    return [python.path for python in bootstrap.usable_pythons(paths)]


def test_starts_on_an_old_python_with_nothing_installed():
    tree = ast.parse(SCRIPT.read_text(encoding="utf-8"), feature_version=(3, 8))
    modules = [node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    modules += [alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names]
    assert {module.split(".")[0] for module in modules} <= set(sys.stdlib_module_names)


def test_no_neighbour_hides_a_module_of_the_standard_library():
    names = {path.stem for path in SCRIPT.parent.iterdir() if path.suffix == ".py" or path.is_dir()}
    assert not names & set(sys.stdlib_module_names)


@pytest.mark.skipif(os.name == "nt", reason="the stubs are shell scripts")
class TestChoice:
    def test_newest_first_past_a_failing_shim(self, bootstrap, tmp_path):
        shims, usual = tmp_path / "shims", tmp_path / "usr"
        broken(shims, "python3.14")
        broken(shims, "python3.13")
        oldest = stub(shims, "python3", (3, 11, 9, "final", 0))
        older = stub(usual, "python3.12", (3, 12, 1, "final", 0))
        newest = stub(usual, "python3.13")
        assert chosen(bootstrap, shims, usual) == [str(newest), str(older), str(oldest)]

    def test_the_name_does_not_decide(self, bootstrap, tmp_path):
        stub(tmp_path, "python3.14", (3, 11, 2, "final", 0))
        newest = stub(tmp_path, "python", (3, 12, 0, "final", 0))
        assert chosen(bootstrap, tmp_path)[0] == str(newest)

    @pytest.mark.parametrize(
        "unfit",
        [
            {"version": (3, 10, 13, "final", 0)},
            {"version": (3, 15, 0, "final", 0)},
            {"version": (3, 14, 0, "candidate", 1)},
            {"implementation": "pypy"},
            {"is_64_bit": False},
            {"without_gil": True},
        ],
    )
    def test_unfit(self, bootstrap, tmp_path, unfit):
        stub(tmp_path, "python3", **unfit)
        assert chosen(bootstrap, tmp_path) == []

    @pytest.mark.parametrize("text", ["exit 0", "echo hello", "echo '[1, 2]'", "echo 3; exit 1"])
    def test_babble(self, bootstrap, tmp_path, text):
        broken(tmp_path, "python3", text)
        assert chosen(bootstrap, tmp_path) == []

    def test_one_interpreter_under_several_names_is_one(self, bootstrap, tmp_path):
        real = stub(tmp_path, "python3.13")
        (tmp_path / "python3").symlink_to(real)
        assert chosen(bootstrap, tmp_path) == [str(real)]

    def test_known_places(self, bootstrap, tmp_path, monkeypatch):
        monkeypatch.setenv("PYENV_ROOT", str(tmp_path / "pyenv"))
        monkeypatch.setenv("HOME", str(tmp_path))
        folders = [tmp_path / "pyenv/versions/3.13.0/bin", tmp_path / ".local/share/uv/python/cpython-3.12/bin"]
        for folder, name in zip(folders, ["python", "python3"], strict=True):
            folder.mkdir(parents=True)
            stub(folder, name)
        found = bootstrap.candidate_paths()
        assert {str(folders[0] / "python"), str(folders[1] / "python3"), sys.executable} <= set(found)

    def test_a_virtual_environment_stands_for_the_python_it_came_from(self, bootstrap):
        [python] = bootstrap.usable_pythons([sys.executable])
        assert python.version == sys.version_info[:3]
        assert Path(python.path).resolve() == Path(sys._base_executable).resolve()


class TestVenv:
    """The steps around .venv, with pip and the interpreters played by the test."""

    @pytest.fixture
    def project(self, bootstrap, tmp_path, monkeypatch):
        monkeypatch.setattr(bootstrap, "ROOT", tmp_path)
        monkeypatch.setattr(bootstrap, "VENV", tmp_path / ".venv")
        monkeypatch.setattr(bootstrap, "STAMP", tmp_path / ".venv" / "stamp.json")
        monkeypatch.setattr(bootstrap, "VENV_DIFFDRIVE", tmp_path / "pyproject.toml")
        (tmp_path / "pyproject.toml").touch()
        newest, older = (
            bootstrap.Python((3, minor, 0), f"Python 3.{minor}.0", "m", f"/p{minor}") for minor in (14, 13)
        )
        bootstrap.tried, bootstrap.said, bootstrap.refuses = [], {}, ()
        monkeypatch.setattr(bootstrap, "usable_pythons", lambda paths: [newest, newest, older])
        monkeypatch.setattr(bootstrap, "probe", lambda path: bootstrap.tried[-1] if bootstrap.tried else None)

        def make_venv(python):
            bootstrap.clear_venv()
            bootstrap.tried.append(python)
            return python.version not in bootstrap.refuses

        def quiet(command, timeout=None):
            text = bootstrap.said.get(bootstrap.tried[-1].version, "")
            return (1 if text else 0), text

        monkeypatch.setattr(bootstrap, "make_venv", make_venv)
        monkeypatch.setattr(bootstrap, "run_quietly", quiet)
        return bootstrap

    @staticmethod
    def versions(project):
        return [python.version[1] for python in project.tried]

    def test_made_once_and_reused(self, project):
        project.prepare([])
        project.prepare([])
        assert self.versions(project) == [14]

    def test_falls_back_where_no_wheel_exists(self, project, capsys):
        project.said[3, 14, 0] = "ERROR: No matching distribution found for jaxlib"
        project.prepare([])
        assert self.versions(project) == [14, 13]
        assert "trying the next older" in capsys.readouterr().err

    def test_falls_back_where_no_venv_can_be_made(self, project):
        project.refuses = {(3, 14, 0)}
        project.prepare([])
        assert self.versions(project) == [14, 14, 13]

    def test_offline_stops_at_once_with_advice(self, project):
        project.said[3, 14, 0] = "WARNING: Retrying (Retry(total=0, connect=None)) after connection broken"
        with pytest.raises(project.SetupError, match="Offline"):
            project.prepare([])
        assert self.versions(project) == [14]

    def test_nothing_works(self, project):
        project.refuses = {(3, 14, 0), (3, 13, 0)}
        with pytest.raises(project.SetupError, match="apt install"):
            project.prepare([])

    def test_interrupted_is_redone(self, project):
        project.prepare([])
        project.write_stamp(ready=False)
        rest = project.VENV / "half-installed"
        rest.mkdir()
        project.prepare([])
        assert self.versions(project) == [14, 14]
        assert not rest.exists()

    def test_an_extra_is_added_in_place(self, project):
        project.prepare([])
        project.prepare(["test"])
        project.prepare([])
        assert self.versions(project) == [14]
        assert project.read_stamp()["extras"] == ["test"]

    def test_offline_update_keeps_what_works(self, project):
        project.prepare([])
        project.said[3, 14, 0] = "NewConnectionError"
        with pytest.raises(project.SetupError):
            project.prepare(["test"])
        project.prepare([])
        assert self.versions(project) == [14]

    def test_what_another_made_is_moved_aside(self, project):
        project.VENV.mkdir()
        (project.VENV / "precious").touch()
        project.prepare([])
        assert [path.name for path in project.ROOT.glob(".venv-old-*/*")] == ["precious"]

    def test_a_moved_folder_is_set_up_anew(self, project):
        project.prepare([])
        project.STAMP.write_text(project.STAMP.read_text().replace(str(project.ROOT), "/elsewhere"))
        project.prepare([])
        assert self.versions(project) == [14, 14]

    def test_python_3_11_is_told_of_full_speed(self, project, monkeypatch, capsys):
        monkeypatch.setattr(
            project, "usable_pythons", lambda paths: [project.Python((3, 11, 2), "Python 3.11.2", "m", "/p")]
        )
        project.prepare([])
        assert capsys.readouterr().err.count("3.12") == 1

    @pytest.mark.skipif(os.name == "nt", reason="the stub is a shell script")
    def test_the_exit_code_and_arguments_pass_through(self, project, monkeypatch, tmp_path, capfd):
        monkeypatch.setattr(project, "VENV_DIFFDRIVE", broken(tmp_path, "diffdrive", 'echo "$@"; exit 7'))
        assert project.main(["demo", "--quick"]) == 7
        assert capfd.readouterr().out == "demo --out results/demo --quick\n"
        assert project.main(["run", "simulate", "a b"]) == 7
        assert capfd.readouterr().out == "simulate a b\n"


@pytest.mark.parametrize(("arguments", "code"), [(["--help"], 0), ([], 2), (["typo"], 2)])
def test_help(arguments, code):
    done = subprocess.run([sys.executable, str(SCRIPT), *arguments], capture_output=True, text=True, check=False)
    assert done.returncode == code
    assert "bootstrap.py demo" in done.stdout
