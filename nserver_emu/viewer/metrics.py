"""Metrics of the daemon for Prometheus (text format 0.0.4), and its health.

    GET /metrics    nserver_connections 3 ...        GET /health    {"status": "ok", ...}, 200 or 503

Names are nserver_WHAT in seconds and bytes; counters end in _total. No label contains an address: connections are
numbered, and the control command `status` has their names.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final, NamedTuple

from nserver_emu.server.daemon import Daemon

CONTENT_TYPE: Final = "text/plain; version=0.0.4; charset=utf-8"
STUCK_S: Final = 5.0
"""A simulation clock that has not ticked for this long is reported as stuck."""
GAUGE, COUNTER = "gauge", "counter"


class Metric(NamedTuple):
    """One metric."""

    name: str
    kind: str
    help: str
    value: float


def all_metrics(daemon: Daemon, viewers: int, tasks: int) -> Iterator[Metric]:
    """Yield all metrics; `viewers` is the number of open pages, `tasks` of asyncio tasks."""
    emulator, connected = daemon.emulator, [connection for connection in daemon.connections if connection.is_connected]
    answered = daemon.closed_answered + sum(connection.session.answered for connection in connected)
    refused = daemon.closed_refused + sum(connection.session.refused for connection in connected)
    yield Metric("connections", GAUGE, "Clients and hosts that are connected.", len(connected))
    yield Metric("turned_away_total", COUNTER, "Connections that were rejected.", daemon.admission.rejected)
    yield Metric("answers_total", COUNTER, "Requests that were answered.", answered)
    yield Metric("refusals_total", COUNTER, "Requests that were answered with an error.", refused)
    cpu_s = daemon.closed_cpu_s + sum(connection.cpu_s for connection in connected)
    yield Metric("cpu_seconds_total", COUNTER, "Processor time that requests have taken.", cpu_s)
    yield Metric("viewers", GAUGE, "Pages that are open.", viewers)
    yield Metric("robots", GAUGE, "Robots in the world.", len(emulator.simulation.robots))
    yield Metric("obstacles", GAUGE, "Obstacles in the world.", len(emulator.simulation.world.obstacles))
    yield Metric("shapes", GAUGE, "Client graphics in memory.", len(emulator.graphics.shapes))
    yield Metric("simulated_seconds", GAUGE, "The simulation's clock.", emulator.simulation.time_s)
    yield Metric("steps_total", COUNTER, "Steps of the simulation.", daemon.steps)
    yield Metric("paused", GAUGE, "1 while simulated time is paused.", int(emulator.clock.paused))
    yield Metric("lost_seconds_total", COUNTER, "Real time that the simulation did not catch up on.", daemon.lost_s)
    yield Metric("tasks", GAUGE, "Asynchronous tasks, the one that answers this request included.", tasks)


def metrics(daemon: Daemon, viewers: int, tasks: int) -> str:
    """Return the metrics in the text format of Prometheus."""
    return "".join(
        f"# HELP nserver_{one.name} {one.help}\n# TYPE nserver_{one.name} {one.kind}\n"
        f"nserver_{one.name} {one.value!r}\n"
        for one in all_metrics(daemon, viewers, tasks)
    ) + _connection_times(daemon)


def _connection_times(daemon: Daemon) -> str:
    """Return the processor time of each connection."""
    name = "nserver_connection_cpu_seconds_total"
    samples = sorted((one.number, one.cpu_s) for one in daemon.connections if one.is_connected)
    head = f"# HELP {name} Processor time that the requests of a connection have taken.\n# TYPE {name} counter\n"
    return head + "".join(f'{name}{{connection="{number}"}} {cpu_s!r}\n' for number, cpu_s in samples)


def health(daemon: Daemon, now_s: float) -> tuple[bool, dict[str, Any]]:
    """Return whether the daemon is healthy, and the body of the reply; `now_s` is the event loop's time."""
    age_s = now_s - daemon.ticked_s
    is_healthy = age_s < STUCK_S
    return is_healthy, {
        "status": "ok" if is_healthy else "clock stuck", "clock_age_s": round(age_s, 3),
        "simulated_s": round(daemon.emulator.simulation.time_s, 3), "paused": daemon.emulator.clock.paused,
    }  # fmt: skip
