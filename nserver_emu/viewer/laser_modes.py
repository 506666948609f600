"""Whose laser mode the map follows: each client of a robot has its own, and the layer shows what any of them is told.

    on      as at power-on, while a robot has no client; else while one of its clients has an odd mode (conf_ls)
    off     every client of it has an even one, 0 say: nothing is drawn

Rules: pages that drive are no clients, for they have no say in it. How many columns count, and lines instead of points,
are one client's own: what is drawn are the points of all columns.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from typing import TYPE_CHECKING, Any, Final

from nserver_emu.server.stage.laser_vector import is_on

if TYPE_CHECKING:
    from nserver_emu.server.ports.talker import Talker

MOST_NAMED: Final = 20
VIEWER: Final = "viewer"
Modes = Mapping[int, list[tuple[str, int]]]
"""By robot its clients, each with its mode: those that have it on first."""


def laser_modes(talkers: Iterable[Talker], robots: Collection[int]) -> Modes:
    """Of these robots."""
    found: dict[int, list[tuple[str, int]]] = {number: [] for number in robots}
    for talker in talkers:
        visit = talker.session.visit
        if talker.here and talker.line != VIEWER and visit.robot_id in found:
            found[visit.robot_id].append((talker.session.name, visit.terms.laser_mode))
    return {number: sorted(clients, key=_on_first)[:MOST_NAMED] for number, clients in found.items()}


def is_shown(clients: list[tuple[str, int]]) -> bool:
    """Whether the laser of a robot with these clients is on for anybody."""
    return not clients or any(is_on(mode) for _, mode in clients)


def _on_first(client: tuple[str, int]) -> tuple[bool, Any]:
    name, mode = client
    return not is_on(mode), name
