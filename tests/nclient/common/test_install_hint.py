"""The extra that installs a module, read from the installed metadata."""

from __future__ import annotations

import shlex
import sys
from importlib import metadata
from pathlib import Path

import pytest

from nclient import errors

ROOT = Path(__file__).parents[3]


@pytest.mark.parametrize(("module", "extra"), [
    # ruff is no dependency of an extra for users, numpy one of the package itself.
    ("shtab", "shell"), ("prompt_toolkit.history", "shell"), ("aiohttp", "viewer"), ("matplotlib.figure", "plot"),
    ("distributed", "cluster"), ("numba", "fast"), ("ruff", ""), ("numpy", ""), ("no_such_module", ""),
])
def test_each_extra_is_found_by_what_it_brings(module: str, extra: str) -> None:
    assert errors.find_extra(module) == extra


def test_hint_installs_the_extra_of_a_module(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    # pip is in the PATH and the clone is the current folder: the short form works.
    monkeypatch.setenv("PATH", str(Path(sys.executable).parent))
    assert errors.install_hint("shtab") == "pip install -e '.[shell]'"
    assert errors.install_hint("no_such_module") == "pip install -e '.[all]'"


def test_hint_has_paths_where_short_names_do_not_work(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    # Neither pip in the PATH nor the clone as current folder: interpreter and paths in full.
    monkeypatch.setenv("PATH", str(tmp_path))
    assert shlex.split(errors.install_command("shell")) == [
        sys.executable, "-m", "pip", "install", "-e", f"{ROOT}[shell]"]


def test_hint_of_an_installed_wheel_names_the_folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(errors, "_CLONE", tmp_path)
    assert errors.install_command("shell") == "pip install -e '.[shell]' in the folder of nomad-nserver"


def test_files_that_were_never_installed_have_no_extras(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(_: str) -> list[str]:
        raise metadata.PackageNotFoundError

    monkeypatch.setattr(metadata, "requires", missing)
    assert errors.find_extra("shtab") == ""
    monkeypatch.setattr(metadata, "requires", lambda _: None)
    assert errors.find_extra("shtab") == ""
