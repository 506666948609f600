"""The wheel, quickly: what it holds, and one clean environment without extras. The rest: scripts/package-check."""

from __future__ import annotations

import re
import sys
import tarfile
from pathlib import Path

import pytest
from clean_install import (
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


def test_the_sdist_holds_what_the_wheel_is_made_from_and_the_docs(distribution: tuple[Path, Path]) -> None:
    with tarfile.open(distribution[1]) as held:
        names = {name.partition("/")[2] for name in held.getnames()}
    wanted = {"pyproject.toml", "README.md", "CHANGELOG.md", "LICENSE", "docs/shell.md", "worlds/thesis_room.toml"}
    wanted |= {"clib/Makefile", "clib/include/Nclient.h", "clib/src/calls.c", "packaging/nserver.service"}
    assert wanted <= names
    assert not any(name.startswith("clib/build") for name in names)


def test_a_clean_environment_without_extras(distribution: tuple[Path, Path], tmp_path: Path) -> None:
    environment = Environment(tmp_path / "clean")
    environment.install(distribution[0])
    assert list(faults(environment, (), QUICK)) == []
    assert list(faults_of_types(environment, "{}.{}".format(*sys.version_info[:2]))) == []


def test_every_extra_is_tried() -> None:
    assert set(EXTRAS) == {check.extra for check in CHECKS if check.extra}
    assert set(EXTRAS) - {"docs"} == set(ALL), "one who wants all of it builds no site"


def test_the_changelog_tells_of_this_version() -> None:
    text = (ROOT / "CHANGELOG.md").read_text()
    released = re.findall(r"^## \[(\d+\.\d+\.\d+)\] - \d{4}-\d\d-\d\d$", text, re.MULTILINE)
    assert released[0] == VERSION
    assert "## [Unreleased]" in text
