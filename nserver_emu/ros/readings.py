"""Readings of a daemon's robots as ROS messages, for rosbridge and for ROS 2 by DDS.

Simulated robots are read without a request, so that watching does not feed a program's motion timeout; a real one is
asked by gs, one question at a time.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from nclient.protocol.replies import Reply
from nclient.protocol.types import MOTOR_RANGE_V, volts
from nclient.recording.ros_messages import TF, Message
from nserver_emu.ros import topics
from nserver_emu.ros.topics import Estimates, Reading
from nserver_emu.server.daemon import Daemon
from nserver_emu.server.server_state import state_slots
from nserver_emu.simulation.robot import battery_v
from nserver_emu.viewer.clients import Answer, ViewerClients
from nserver_emu.viewer.error_boundary import ErrorBoundary
from worlds.cells import cells_of_world
from worlds.rings import Ring
from worlds.world import World

PERIOD_S: Final = 0.05
"""Interval at which robots are read: twenty times a second, as for the page."""
MAP_CELL_IN: Final = 2.0
"""Cells of /map: 5 cm."""
MAX_MAP_CELLS: Final = 1_000_000
"""50 x 50 m of such cells; larger worlds get larger cells, since all robots wait while the map is made."""
MAX_DRIFT: Final = 1e-3
"""Largest drift of a robot's clock against that of this machine: ten times that of a poor quartz."""
MAX_DELAY_S: Final = 1.0
"""A longer delay than this means that the robot's clock was set, or stands still."""
MAX_ESTIMATE_AGE_S: Final = 60.0
"""An estimate with an older or later time is not by this robot's clock."""

Publish = Callable[[str, Message], None]
"""Called with a topic and its message."""


@dataclass(slots=True)
class RobotClock:
    """Unix times of a robot's clock.

    The offset between both clocks is the smallest that was seen, since a delay of the line makes it larger. It may
    grow by the drift, so that the times follow a robot's clock that is slow.
    """

    _offset_s: float = math.inf
    _seen_s: float = -math.inf

    def time_ns(self, clock_s: float, now_s: float) -> int:
        """Return the Unix time of a reading at `clock_s` that arrived at the Unix time `now_s`."""
        offset_s = now_s - clock_s
        expected_s = self._offset_s + MAX_DRIFT * (now_s - self._seen_s)
        # A clock that was set gets a new offset.
        self._offset_s = offset_s if offset_s > expected_s + MAX_DELAY_S else min(offset_s, expected_s)
        self._seen_s = now_s
        return round((clock_s + self._offset_s) * 1e9)

    def past_time_ns(self, clock_s: float, now_s: float) -> int:
        """Return the Unix time of an earlier reading; `now_s` if it cannot be by this clock."""
        time_s = clock_s + self._offset_s
        return round((time_s if now_s - MAX_ESTIMATE_AGE_S < time_s <= now_s else now_s) * 1e9)


class RobotReader:
    """Reads a daemon's robots and passes their messages to `publish`."""

    def __init__(
        self, daemon: Daemon, name: str, error_boundary: ErrorBoundary, publish: Publish, estimates: Estimates
    ) -> None:
        self._daemon = daemon
        self._publish = publish
        self._estimates = estimates
        self._clocks = {robot: RobotClock() for robot in daemon.emulator.simulation.robots}
        # A real robot is asked for its state on connections of the reader's own.
        self._clients = ViewerClients(daemon, name, error_boundary, answer_with_reply)
        self._asked: set[int] = set()
        estimates.listeners.append(self._publish_estimate)

    def close(self) -> None:
        """Close the connections to the robots. May be called twice."""
        with suppress(ValueError):
            self._estimates.listeners.remove(self._publish_estimate)
        self._clients.close()

    def read(self, robot: int) -> None:
        """Publish the state of a robot, now or when it answers."""
        daemon = self._daemon
        if daemon.handler is daemon.emulator:
            simulation = daemon.emulator.simulation
            simulated = simulation.robots[robot]
            slots = state_slots(simulated, daemon.emulator.clock.speed_tenths)
            readings_in = () if simulated.model.body.ring.fits_state else simulated.sonar.readings_in
            self._publish_reading(robot, slots, battery_v(simulation.time_s), simulation.time_s, readings_in)
        elif robot not in self._asked:
            # One question at a time: a slow line is not asked faster than it answers.
            self._asked.add(robot)
            self._clients.call(robot, "gs", [], lambda answer: self._answered(robot, answer))

    def static_frames(self) -> Message:
        """Return the frames of the sonars of all robots."""
        return topics.static_frames(rings_of(self._daemon), time.time_ns())

    def _answered(self, robot: int, answer: Answer) -> None:
        self._asked.discard(robot)
        reply = answer.get("reply")
        if answer["ok"] and reply is not None and reply.slots:
            raw = reply.volts[1] if reply.volts else None
            slots = [reply.slots.get(slot, 0) for slot in range(45)]
            motors_v = None if raw is None else volts(raw, MOTOR_RANGE_V)
            self._publish_reading(robot, slots, motors_v, (reply.clock or 0) / 1000)

    def _publish_reading(
        self, robot: int, slots: list[int], motors_v: float | None, clock_s: float, readings_in: Sequence[float] = ()
    ) -> None:
        model = self._daemon.emulator.simulation.robots[robot].model
        time_ns = self._clocks[robot].time_ns(clock_s, time.time())
        ring = model.body.ring
        reading = Reading(robot, slots, model.track_in is not None, time_ns, motors_v, ring, readings_in)
        for topic, message in topics.messages_of(reading):
            self._publish(topic, message)
        self._publish(TF, topics.frames(reading, self._estimates.map_to_odom(robot)))

    def _publish_estimate(self, robot: int, estimate: dict[str, Any]) -> None:
        time_ns = self._clocks[robot].past_time_ns(estimate["clock_s"], time.time())
        self._publish(f"/robot{robot}/pose", topics.estimate_message(estimate, time_ns))


def rings_of(daemon: Daemon) -> dict[int, Ring]:
    """Return the sonars of all robots."""
    return {number: robot.model.body.ring for number, robot in daemon.emulator.simulation.robots.items()}


def map_message(world: World) -> Message:
    """Return /map. Raises ImportError without the extra `maps`, ValueError if the world has no walls."""
    if not len(world.walls):
        raise ValueError(f"the world {world.name} has no walls")
    return topics.grid_message(cells_of_world(world, map_cell_in(world)), time.time_ns())


def map_cell_in(world: World) -> float:
    """Return the size of the cells of /map: MAP_CELL_IN, twice that for a large world, and so on."""
    wide, high = np.ptp(world.walls.reshape(-1, 2), axis=0).tolist()
    size = MAP_CELL_IN
    while wide * high > MAX_MAP_CELLS * size**2:
        size *= 2.0
    return size


def answer_with_reply(name: str, reply: Reply) -> Answer:
    """Return the answer to a call with its whole reply."""
    del name
    return {"ok": reply.kind != "error", "values": list(reply.values), "reply": reply}
