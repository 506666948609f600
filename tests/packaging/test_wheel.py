"""Wheel and sdist, quickly: what they hold, one clean environment without extras. The rest: scripts/package-check."""

from __future__ import annotations

import os
import re
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

from tests.packaging.clean_install import (
    ALL,
    CHECKS,
    EXTRAS,
    ROOT,
    USER_SCRIPT,
    VERSION,
    Environment,
    built,
    faults,
    faults_of_types,
    missing_from,
    tracked,
)

WORKING = ("--version", str(USER_SCRIPT))
QUICK = tuple(check for check in CHECKS if (check.extra and check.says) or check.words[-1] in WORKING)


@pytest.fixture(scope="module")
def distribution(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    wheel, sdist = built(tmp_path_factory.mktemp("distribution"))
    return wheel, sdist


def test_the_wheel_holds_all_the_files_of_the_packages(distribution: tuple[Path, Path]) -> None:
    wheel, _ = distribution
    assert missing_from(wheel) == set()
    assert wheel.name == f"nomad_nserver-{VERSION}-py3-none-any.whl"


def test_the_wheel_holds_nothing_beside_the_packages(distribution: tuple[Path, Path]) -> None:
    with zipfile.ZipFile(distribution[0]) as held:
        tops = {name.partition("/")[0] for name in held.namelist()}
    packages = {"nclient", "nserver_emu", "localization", "worlds"}
    assert tops == packages | {"nomad_start.py", f"nomad_nserver-{VERSION}.dist-info"}


def test_the_sdist_holds_all_that_its_scripts_need_and_that_can_still_be_run(distribution: tuple[Path, Path]) -> None:
    with tarfile.open(distribution[1]) as held:
        files = {member.name.partition("/")[2]: member for member in held.getmembers() if member.isfile()}
    wanted = {"pyproject.toml", "README.md", "CHANGELOG.md", "LICENSE", "docs/shell.md", "worlds/thesis_room.toml"}
    wanted |= {"clib/Makefile", "clib/include/Nclient.h", "clib/src/calls.c", "packaging/nserver.service"}
    wanted |= {"tests/packaging/test_wheel.py", "benchmarks/soak.py", "fuzz/saved_files.py", ".ci/run"}
    assert wanted <= set(files)
    assert all(files[f"scripts/{path.name}"].mode & 0o100 for path in (ROOT / "scripts").iterdir() if _runs(path))


@pytest.mark.skipif(not tracked(), reason="no git here: this tree is an unpacked sdist itself")
def test_the_sdist_holds_what_git_tracks_and_nothing_else(distribution: tuple[Path, Path]) -> None:
    with tarfile.open(distribution[1]) as held:
        names = {member.name.partition("/")[2] for member in held.getmembers() if member.isfile()}
    made = {name for name in names if name.startswith("nomad_nserver.egg-info/")} | {"PKG-INFO", "setup.cfg"}
    assert sorted(tracked() - names) == [], "MANIFEST.in says what goes in"
    assert sorted(names - tracked() - made) == []


def test_a_clean_environment_without_extras(distribution: tuple[Path, Path], tmp_path: Path) -> None:
    environment = Environment(tmp_path / "clean")
    environment.install(distribution[0])
    assert list(faults(environment, (), QUICK)) == []
    assert list(faults_of_types(environment, "{}.{}".format(*sys.version_info[:2]))) == []


def _runs(path: Path) -> bool:
    return path.is_file() and os.access(path, os.X_OK)


def test_every_extra_is_tried() -> None:
    assert set(EXTRAS) == {check.extra for check in CHECKS if check.extra}
    assert set(EXTRAS) - {"docs"} == set(ALL), "one who wants all of it builds no site"


def test_the_changelog_tells_of_this_version() -> None:
    text = (ROOT / "CHANGELOG.md").read_text()
    released = re.findall(r"^## \[(\d+\.\d+\.\d+)\] - \d{4}-\d\d-\d\d$", text, re.MULTILINE)
    assert released[0] == VERSION
    assert "## [Unreleased]" in text
