"""What this process would run: so that numbers kept or made elsewhere are known to be the ones it would make itself.

Rules: reads the files of the packages, imports none of them.
"""

from __future__ import annotations

from collections.abc import Iterator
from hashlib import sha256
from importlib.util import find_spec
from pathlib import Path
from typing import Final

import numpy as np

CODE: Final = ("localization", "nclient", "nserver_emu", "worlds")
"""The packages an experiment runs through."""
SUFFIXES: Final = (".py", ".toml")


def fingerprint() -> str:
    """What this process would run: a digest of the project's code and worlds, and of numpy's version."""
    digest = sha256(np.__version__.encode())
    for name, content in sorted(_sources().items()):
        digest.update(f"{name}\0{sha256(content).hexdigest()}\n".encode())
    return digest.hexdigest()


def _sources() -> dict[str, bytes]:
    """Every file of the packages, by its name in them."""
    return {
        f"{package}/{path.relative_to(folder).as_posix()}": path.read_bytes()
        for package in CODE
        for folder in _folders(package)
        for path in folder.rglob("*")
        if path.suffix in SUFFIXES
    }


def _folders(package: str) -> Iterator[Path]:
    spec = find_spec(package)
    assert spec is not None
    return map(Path, spec.submodule_search_locations or ())
