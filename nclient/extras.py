"""Which extra of this distribution brings a module: for the one error where a module is missing.

Rules: read off the installed distribution's own metadata, so that pyproject.toml is the only list of extras.
"""

from __future__ import annotations

import re
from importlib.metadata import PackageNotFoundError, requires

from nclient.distribution import DISTRIBUTION

_GROUPS = frozenset({"all", "dev", "bench"})
"""Extras that bring others, or nothing that the commands want."""
_REQUIREMENT = re.compile(r"""(?P<name>[\w.-]+).*extra == ["'](?P<extra>[\w-]+)["']""")


def remedy(module: str) -> str:
    """What installs the module: `pip install 'nomad-nserver[EXTRA]'`."""
    return f"pip install '{DISTRIBUTION}[{extra_of(module) or 'all'}]'"


def extra_of(module: str) -> str:
    """The extra that brings a module; "" where none does, or where this was not installed as a distribution."""
    wanted = _plain(module.partition(".")[0])
    try:
        texts = requires(DISTRIBUTION) or []
    except PackageNotFoundError:
        return ""
    found = filter(None, map(_REQUIREMENT.match, texts))
    return next((one["extra"] for one in found if _plain(one["name"]) == wanted and one["extra"] not in _GROUPS), "")


def _plain(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()
