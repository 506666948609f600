"""Check that every package is in exactly one layer of the import contract."""

from __future__ import annotations

from pathlib import Path

from docs.generate.layers import layers

ROOT = Path(__file__).parents[1]


def test_every_package_is_in_one_layer() -> None:
    found = [
        f"{package}.{path.stem}"
        for package in ("nclient", "nserver_emu", "localization")
        for path in (ROOT / package).iterdir()
        if (path.is_dir() and (path / "__init__.py").exists()) or (path.suffix == ".py" and path.stem != "__init__")
    ]
    assert sorted(module for layer in layers() for module in layer) == sorted([*found, "worlds"])


def test_there_are_seven_layers() -> None:
    assert len(layers()) == 7
