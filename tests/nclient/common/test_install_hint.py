"""The extra that installs a module, read from the installed metadata."""

from __future__ import annotations

from importlib import metadata

import pytest

from nclient.common import hints


@pytest.mark.parametrize(("module", "extra"), [
    ("shtab", "shell"), ("prompt_toolkit.history", "shell"), ("aiohttp", "viewer"), ("matplotlib.figure", "plot"),
    ("distributed", "cluster"), ("numba", "fast"), ("ruff", ""), ("numpy", ""), ("no_such_module", ""),
])
def test_each_extra_is_found_by_what_it_brings(module: str, extra: str) -> None:
    assert hints.find_extra(module) == extra


def test_a_remedy_is_what_one_types() -> None:
    assert hints.install_hint("shtab") == "pip install 'nomad-nserver[shell]'"
    assert hints.install_hint("no_such_module") == "pip install 'nomad-nserver[all]'"


def test_files_that_were_never_installed_have_no_extras(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(_: str) -> list[str]:
        raise metadata.PackageNotFoundError

    monkeypatch.setattr(metadata, "requires", missing)
    assert hints.find_extra("shtab") == ""
    monkeypatch.setattr(metadata, "requires", lambda _: None)
    assert hints.find_extra("shtab") == ""
