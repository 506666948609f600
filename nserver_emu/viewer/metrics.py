"""The daemon in numbers: for Prometheus (text format 0.0.4), and whether it is well. Who may ask is web.py's.

    GET /metrics    nserver_connections 3 ...        GET /health    {"status": "ok", ...}, 200 or 503

Rules: names are nserver_WHAT, seconds and bytes as they are, counters end in _total. No label tells an address.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, Final, NamedTuple

if TYPE_CHECKING:
    from nserver_emu.server.daemon import Daemon

CONTENT_TYPE: Final = "text/plain; version=0.0.4; charset=utf-8"
STUCK_S: Final = 5.0
"""A clock that has not ticked for so long is not well."""
GAUGE, COUNTER = "gauge", "counter"


class Number(NamedTuple):
    """One metric."""

    name: str
    kind: str
    help: str
    value: float


def numbers(daemon: Daemon, viewers: int, tasks: int) -> Iterator[Number]:
    """Everything that is counted; `viewers`: pages that are open, `tasks`: what the loop has under way."""
    emulator, here = daemon.emulator, [one for one in daemon.connections if one.is_connected]
    answered = daemon.closed_answered + sum(one.session.answered for one in here)
    refused = daemon.closed_refused + sum(one.session.refused for one in here)
    yield Number("connections", GAUGE, "Clients and hosts that are connected.", len(here))
    yield Number("turned_away_total", COUNTER, "Newcomers that were not let in.", daemon.admission.rejected)
    yield Number("answers_total", COUNTER, "Requests that were answered.", answered)
    yield Number("refusals_total", COUNTER, "Requests that were answered with an error.", refused)
    yield Number("viewers", GAUGE, "Pages that are open.", viewers)
    yield Number("robots", GAUGE, "Robots in the world.", len(emulator.simulation.robots))
    yield Number("obstacles", GAUGE, "Obstacles in the world.", len(emulator.simulation.world.obstacles))
    yield Number("shapes", GAUGE, "Client graphics that are kept.", len(emulator.graphics.shapes))
    yield Number("simulated_seconds", GAUGE, "The simulation's clock.", emulator.simulation.time_s)
    yield Number("steps_total", COUNTER, "How often simulated time was made to pass.", daemon.steps)
    yield Number("paused", GAUGE, "1 while simulated time stands.", int(emulator.clock.paused))
    yield Number("lost_seconds_total", COUNTER, "Real time that the simulation did not catch up on.", daemon.lost_s)
    yield Number("tasks", GAUGE, "Asynchronous tasks, the one that answers this among them.", tasks)


def metrics(daemon: Daemon, viewers: int, tasks: int) -> str:
    """The text that Prometheus reads."""
    return "".join(
        f"# HELP nserver_{one.name} {one.help}\n# TYPE nserver_{one.name} {one.kind}\n"
        f"nserver_{one.name} {one.value!r}\n"
        for one in numbers(daemon, viewers, tasks)
    )


def health(daemon: Daemon, now_s: float) -> tuple[bool, dict[str, Any]]:
    """Whether it is well, and what to say of it. `now_s`: the loop's time."""
    age_s = now_s - daemon.ticked_s
    well = age_s < STUCK_S
    return well, {
        "status": "ok" if well else "clock stuck", "clock_age_s": round(age_s, 3),
        "simulated_s": round(daemon.emulator.simulation.time_s, 3), "paused": daemon.emulator.clock.paused,
    }  # fmt: skip
