"""Contents of wheel and sdist, and one clean environment without extras; scripts/package-check checks all of them."""

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
    build_distribution,
    find_failures,
    find_missing_files,
    find_type_errors,
    tracked_files,
)

WORKING = ("--version", str(USER_SCRIPT))
# Checks that take seconds: errors for missing extras, the version, and the user's script.
QUICK = tuple(check for check in CHECKS if (check.extra and check.is_hinted) or check.words[-1] in WORKING)


@pytest.fixture(scope="module")
def distribution(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    wheel, sdist = build_distribution(tmp_path_factory.mktemp("distribution"))
    return wheel, sdist


def test_wheel_has_all_package_files(distribution: tuple[Path, Path]) -> None:
    wheel, _ = distribution
    assert find_missing_files(wheel) == set()
    assert wheel.name == f"nomad_nserver-{VERSION}-py3-none-any.whl"


def test_wheel_has_only_the_packages(distribution: tuple[Path, Path]) -> None:
    with zipfile.ZipFile(distribution[0]) as archive:
        tops = {name.partition("/")[0] for name in archive.namelist()}
    packages = {"nclient", "nserver_emu", "localization", "worlds"}
    assert tops == packages | {f"nomad_nserver-{VERSION}.dist-info"}


def test_sdist_has_files_for_its_scripts(distribution: tuple[Path, Path]) -> None:
    with tarfile.open(distribution[1]) as archive:
        files = {member.name.partition("/")[2]: member for member in archive.getmembers() if member.isfile()}
    wanted = {"pyproject.toml", "README.md", "CHANGELOG.md", "LICENSE", "docs/shell.md", "worlds/thesis_room.toml"}
    # A sample of each folder that the scripts need; the next test compares all files.
    wanted |= {"clib/Makefile", "clib/include/Nclient.h", "clib/src/calls.c", "packaging/nserver.service"}
    wanted |= {"tests/packaging/test_wheel.py", "benchmarks/soak.py", "fuzz/saved_files.py", ".ci/run"}
    assert wanted <= set(files)
    assert all(files[f"scripts/{path.name}"].mode & 0o100 for path in (ROOT / "scripts").iterdir() if _runs(path))


@pytest.mark.skipif(not tracked_files(), reason="no git here: this tree is an unpacked sdist itself")
def test_sdist_has_exactly_the_tracked_files(distribution: tuple[Path, Path]) -> None:
    with tarfile.open(distribution[1]) as archive:
        names = {member.name.partition("/")[2] for member in archive.getmembers() if member.isfile()}
    # Files that setuptools adds itself.
    made = {name for name in names if name.startswith("nomad_nserver.egg-info/")} | {"PKG-INFO", "setup.cfg"}
    assert sorted(tracked_files() - names) == [], "MANIFEST.in lists the contents"
    assert sorted(names - tracked_files() - made) == []


def test_a_clean_environment_without_extras(distribution: tuple[Path, Path], tmp_path: Path) -> None:
    environment = Environment(tmp_path / "clean")
    environment.install_with_links(distribution[0])
    assert list(find_failures(environment, (), QUICK)) == []
    assert list(find_type_errors(environment, "{}.{}".format(*sys.version_info[:2]))) == []


def _runs(path: Path) -> bool:
    return path.is_file() and os.access(path, os.X_OK)


def test_every_extra_is_tried() -> None:
    assert set(EXTRAS) == {check.extra for check in CHECKS if check.extra}
    # Without the tools for the documentation, and numba for machines that must build it: elsewhere it is a dependency.
    assert set(EXTRAS) - {"docs", "fast"} == set(ALL)


def test_changelog_has_this_version() -> None:
    text = (ROOT / "CHANGELOG.md").read_text()
    released = re.findall(r"^## \[(\d+\.\d+\.\d+)\] - \d{4}-\d\d-\d\d$", text, re.MULTILINE)
    assert released[0] == VERSION
    assert "## [Unreleased]" in text
