"""Actions of the page: carries out messages from pages on the daemon. No sockets; time is an argument.

    ViewerController.handle_message ──> action of the message ──> reply message
    ViewerClients.call ──> reply of the robot ──> reply message

What a page does to a robot is sent as a client of that robot would send it (clients.py). A viewer that may only watch
gets an error for everything else. A learned map is adjusted to measured lengths by `nomad map edit`, in a process of
its own; the page then replaces the world, as by loading a file, so that it can undo the step.
"""

from __future__ import annotations

import asyncio
import json
import logging
import subprocess
import tempfile
from collections import Counter
from collections.abc import Callable, Coroutine, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

import numpy as np

from nclient.common.process import NOMAD
from nclient.protocol.types import WireState, heading_tenths, tenths
from nserver_emu.control.commands import WORLD_SET, answer_line, answer_line_in_thread
from nserver_emu.server.daemon import Daemon
from nserver_emu.viewer import messages
from nserver_emu.viewer.classroom import refusal
from nserver_emu.viewer.clients import Answer, ErrorBoundary, ViewerClient, ViewerClients
from nserver_emu.viewer.http_port import Access
from nserver_emu.viewer.localizers import Localizers
from nserver_emu.viewer.messages import STALE_S, Tape, TrafficMonitor, parse_published
from nserver_emu.viewer.scene import Broadcaster, Viewer
from worlds.io import SHIPPED, format_world, load_world, world_names

log = logging.getLogger(__name__)


@lru_cache(maxsize=1)
def shipped_worlds() -> Answer:
    """Return name, title, file and walls in whole inches of every shipped world."""
    worlds = [(name, load_world(name)) for name in world_names()]
    return {
        "ok": True,
        "worlds": [
            {"name": name, "title": world.title, "text": (SHIPPED / f"{name}.toml").read_text(encoding="utf-8"),
             "walls": np.rint(world.walls.reshape(-1, 4)).astype(int).tolist()}
            for name, world in worlds
        ],
    }  # fmt: skip


class ViewerController:
    """State that all viewers share: the daemon, open pages, requested poses, waypoints."""

    def __init__(self, daemon: Daemon, broadcaster: Broadcaster, names: Mapping[int, str] | None = None) -> None:
        self.daemon = daemon
        self._names = names or {}
        """Students by robot."""
        self._starts = {number: robot.actual for number, robot in daemon.emulator.simulation.robots.items()}
        """Poses at the start, to which *Reset* returns."""
        self.broadcaster = broadcaster
        self.error_boundary = ErrorBoundary()
        self._sent: dict[str, Mapping[int, object]] = {"programs": {}, "asked": {}}
        """Values by robot that pages have, by type of the message; sent again when they change."""
        self.waypoints: dict[int, list[list[float]]] = {}
        """Goal of each robot, as set at a page."""
        self._waypoints_set: Counter[int] = Counter()
        self._waypoints_received: Counter[int] = Counter()
        """How often they were set, by robot, and that number when its localizer last got them."""
        self._clients: dict[Viewer, ViewerClients] = {}
        self._reading: dict[asyncio.Task[Answer], Viewer | None] = {}
        """Answers for which files are read; of a world with its page, which waits for it before it sets another one."""
        self._published: dict[tuple[str, int], tuple[float, dict[str, Any]]] = {}
        """When the last message of each kind was published of each robot, and its fields."""
        self.localizers = Localizers(daemon, self._send_localizers)
        # The monitor takes the recorder's place and passes everything on to it.
        self.traffic_monitor = TrafficMonitor(daemon.recorder, self._wire_state_of,
                                              lambda: daemon.emulator.simulation.time_s)
        daemon.recorder = self.traffic_monitor

    def connect_page(self, now: float, access: Access, *, watch_token: str = "") -> Viewer:
        """Add a page: send it the present state, and return its viewer."""
        # 1. What a new page must know before its first picture.
        viewer = self.broadcaster.join(may_act=access.may_act, person=access.name)
        viewer.robot = access.robot
        viewer.notify(messages.encode_message("hello", version=messages.VERSION, name=viewer.name,
                            may_act=access.may_act, watch_token=watch_token if access.may_act else None,
                            waypoints=self.waypoints, lines=dict(self.daemon.lines()) if access.may_act else {},
                            robot=access.robot, names=self._names,
                            own_methods=list(self.localizers.own_methods)))
        for kind, robots in self._sent.items():
            viewer.notify(messages.encode_message(kind, robots=robots))
        viewer.notify(messages.encode_message("localizers", robots=self.localizers.as_dict()))
        # 2. Estimates and maps that are not outdated.
        for (kind, _), (published_at, fields) in self._published.items():
            if now - published_at < STALE_S:
                viewer.notify(messages.encode_message(kind, **fields, age_s=round(now - published_at, 1)))
        self._clients[viewer] = ViewerClients(self.daemon, viewer.name, self.error_boundary)
        self._accept_pose_clicks()
        return viewer

    def leave(self, viewer: Viewer) -> None:
        """Remove a page; what it drove stops."""
        self.broadcaster.viewers.discard(viewer)
        self._clients.pop(viewer).close()
        self.traffic_monitor.watched = self.broadcaster.watch_traffic
        self._accept_pose_clicks()

    def tick(self, now: float) -> None:
        """Stop robots whose driver is silent, then send pose requests, states of localizers and traffic."""
        for clients in self._clients.values():
            clients.tick(now)
        with self.error_boundary.guard("pose requests"):
            self._send_changed("asked", self.daemon.emulator.pose_requests.counts())
            self._send_changed("programs", self._programs())
        with self.error_boundary.guard("the maps of localizers"):
            self.localizers.check_maps()
        with self.error_boundary.guard("the traffic"):
            self._send_traffic()

    def close(self) -> None:
        """Restore the daemon's own recorder, and drop worlds that are still being read."""
        for reading in self._reading:
            reading.cancel()
        self.daemon.recorder = self.traffic_monitor.inner

    def handle_message(self, viewer: Viewer, text: str, now: float) -> None:
        """Carry out a message from a page; every error becomes a reply."""
        try:
            # 1. Form of the message.
            message = messages.parse_message(text)
        except messages.InvalidMessage as error:
            self._refuse(viewer, error.number, str(error))
            return
        # 2. Permission.
        number = getattr(message, "id", None)
        if not isinstance(message, messages.Seen | messages.Watch) and not viewer.may_act:
            self._refuse(viewer, number, "this link only looks")
            return
        if viewer.robot is not None:
            hold = self.daemon.emulator.estop.get(viewer.robot)
            if reason := refusal(message, viewer.robot, viewer.person, hold.operators if hold else ()):
                self._refuse(viewer, number, reason)
                return

        with self.error_boundary.guard("a message of a page", viewer.name, self._internal_error(viewer, number)):
            try:
                self._carry_out(message, viewer, now)
            except messages.InvalidMessage as error:
                self._refuse(viewer, number, str(error))

    def _carry_out(self, message: messages.Message, viewer: Viewer, now: float) -> None:
        match message:
            case messages.Seen():
                viewer.mark_drawn(message.frame)
            case messages.Watch():
                viewer.traffic, viewer.laser, viewer.laser_robot = message.traffic, message.laser, message.robot
                self.traffic_monitor.watched = self.broadcaster.watch_traffic
            case messages.CallRobot():
                self._call(viewer, message)
            case messages.Drive():
                reply, others = _replier(viewer, message.id), self.others(viewer, message.robot)
                self.clients(viewer).drive(message.robot, message.args, now,
                                           lambda answer: reply(answer | {"others": others}))
            case messages.Stop() | messages.Release():
                robots = self.robots(message.robot)
                if isinstance(message, messages.Stop):
                    self.daemon.hold(robots, viewer.name)
                else:
                    self.daemon.release(robots)
                _replier(viewer, message.id)({"ok": True, "held": self.daemon.emulator.estop.as_dict()})
            case messages.Reset():
                self._reset(viewer, message)
            case messages.ControlServer():
                # The same form as on the control socket, so that both have the same checks and replies.
                request = json.dumps({"command": message.command, "argument": message.argument}).encode()
                if message.command != WORLD_SET:
                    _replier(viewer, message.id)(json.loads(answer_line(self.daemon, request)))
                elif viewer in self._reading.values():
                    raise messages.InvalidMessage(f"{WORLD_SET}: the last world is still being read; repeat it after "
                                                  "its reply")
                else:
                    world_set = self._read_world(request)
                    self._answer_later(viewer, message.id, world_set, "a world of a page", is_world=True)
            case messages.Click():
                x, y, steer, turret = message.pose
                if not self.daemon.emulator.pose_requests.answer(message.robot, (x, y, steer, turret)):
                    self._refuse(viewer, None, f"no client asks for a pose of robot {message.robot}")
            case messages.Waypoints():
                self.set_waypoints(message.robot, message.points)
            case messages.Localize():
                self.robots(message.robot)
                self.localizers.start(message.robot, message.method, is_lost=message.is_lost, resumes=message.resumes)
                _replier(viewer, message.id)({"ok": True})
            case messages.Adjust():
                if None in self._reading.values():
                    raise messages.InvalidMessage("another page's files are being read; repeat it in a moment")
                world = self.daemon.emulator.simulation.world
                adjusted = asyncio.to_thread(lambda: adjust_world(message.text or format_world(world), message.lengths))
                self._answer_later(viewer, message.id, adjusted, "files for a page")
            case messages.Gallery():
                self._answer_later(viewer, message.id, asyncio.to_thread(shipped_worlds), "files for a page")
            case messages.Kidnap():
                self.robots(message.robot)
                self._kidnap(viewer, message)
            case messages.Unlocalize():
                self.localizers.stop(message.robot)
                _replier(viewer, message.id)({"ok": True})

    def _reset(self, viewer: Viewer, message: messages.Reset) -> None:
        """Return robots to their starts, as often as one more start becomes free; what holds them stays.

        Raises
        ------
        InvalidMessage
            If robots are real, or a start is occupied; the others are there.
        """
        if self.daemon.handler is not self.daemon.emulator:
            raise messages.InvalidMessage("a real robot cannot be placed from here: carry it to its start")
        clients, waiting = self.clients(viewer), self.robots(message.robot)
        while placed := [robot for robot in waiting if self._return_to_start(clients, robot)]:
            waiting = [robot for robot in waiting if robot not in placed]
        if waiting:
            numbers = ", ".join(map(str, waiting))
            raise messages.InvalidMessage(f"reset: no room at the starts of robots {numbers}: move what stands there, "
                                          "and repeat it")
        _replier(viewer, message.id)({"ok": True})

    def _return_to_start(self, clients: ViewerClients, robot: int) -> bool:
        """Place a robot where it started; return False if something else is there."""
        start = self._starts.get(robot)
        if start is None:
            return False
        answers: list[Answer] = []
        angles = heading_tenths(start.steering_rad), heading_tenths(start.turret_rad)
        clients.call(robot, "place_robot", [tenths(start.x_in), tenths(start.y_in), *angles], answers.append)
        is_placed = bool(answers and answers[0]["ok"])
        if is_placed:
            self.localizers.mark_placed(robot)
        return is_placed

    def _call(self, viewer: Viewer, message: messages.CallRobot) -> None:
        reply = _replier(viewer, message.id)

        def finish(answer: Answer) -> None:
            if answer["ok"] and message.call == "place_robot":
                self.localizers.mark_placed(message.robot)
            reply(answer)

        self.clients(viewer).call(message.robot, message.call, message.args, finish)

    def _answer_later(self, viewer: Viewer, number: int, answer: Coroutine[Any, Any, Answer], place: str, *,
                      is_world: bool = False) -> None:
        """Send a viewer an answer for which files are read in a thread; `place` is for the log."""
        reading = asyncio.create_task(answer)
        self._reading[reading] = viewer if is_world else None

        def finish(reading: asyncio.Task[Answer]) -> None:
            del self._reading[reading]
            if not reading.cancelled():
                with self.error_boundary.guard(place, viewer.name, self._internal_error(viewer, number)):
                    _replier(viewer, number)(reading.result())

        reading.add_done_callback(finish)

    async def _read_world(self, request: bytes) -> Answer:
        answer: Answer = json.loads(await answer_line_in_thread(self.daemon, request))
        return answer

    def _kidnap(self, viewer: Viewer, message: messages.Kidnap) -> None:
        """Place a robot, and set its encoders back to what they were: three calls in one turn of the event loop.

        Raises
        ------
        InvalidMessage
            If robots are real: of those only the encoders would be set.
        """
        if self.daemon.handler is not self.daemon.emulator:
            raise messages.InvalidMessage("a real robot cannot be placed from here: carry it to another place")
        clients, encoder = self.clients(viewer), self.daemon.emulator.simulation.robots[message.robot].encoder
        positions = [tenths(encoder.x_in), tenths(encoder.y_in)]
        angles = [heading_tenths(encoder.steering_rad), heading_tenths(encoder.turret_rad)]

        def restore(answer: Answer) -> None:
            if answer["ok"]:
                clients.call(message.robot, "dp", positions, lambda _: None)
                clients.call(message.robot, "da", angles, lambda _: None)
            _replier(viewer, message.id)(answer)

        clients.call(message.robot, "place_robot", message.pose, restore)

    def publish(self, text: str, now: float, only: int | None = None) -> dict[str, Any]:
        """Show a localizer's estimate, or a map that is being learned, on all pages; return the reply with waypoints.

        `only` is the robot of a student's token; None allows all.

        Raises
        ------
        InvalidMessage
            If the message is wrong or names no robot.
        """
        kind, fields = parse_published(text)
        robot = fields["robot"]
        if robot not in self.daemon.emulator.simulation.robots:
            raise messages.InvalidMessage(f"there is no robot {robot}")
        if only not in (None, robot):
            raise messages.InvalidMessage(f"this link publishes estimates of robot {only} only")
        has_begun = fields.pop("began")
        if kind == "localization":
            # A new localizer gets the waypoints that none before it got, unless it has some of its own.
            is_new = self._waypoints_received[robot] < self._waypoints_set[robot] and not fields["waypoints"]
            if has_begun and self.waypoints.get(robot) and not is_new:
                self.set_waypoints(robot, [])
            self._waypoints_received[robot] = self._waypoints_set[robot]
            self.localizers.mark_published(robot)
        self._published[kind, robot] = now, fields
        self.broadcaster.notify(messages.encode_message(kind, **fields, age_s=0.0))
        return {"waypoints": self.waypoints.get(robot), "set": self._waypoints_set[robot]}

    def set_waypoints(self, robot: int, points: list[list[float]]) -> None:
        """Set a robot's waypoints, in inches."""
        self.waypoints[robot] = points
        self._waypoints_set[robot] += 1
        self.broadcaster.notify(messages.encode_message("waypoints", robot=robot, points=points))

    def others(self, viewer: Viewer, robot: int) -> list[str]:
        """Return the names of the other viewers that drive this robot now."""
        return [clients.name for other, clients in self._clients.items() if other is not viewer
                and clients.is_driving(robot)]

    def robots(self, named: int | None) -> list[int]:
        """Return the robots that a message is about: the one it names, or all. Raises InvalidMessage."""
        robots = list(self.daemon.emulator.simulation.robots)
        if named is not None and named not in robots:
            raise messages.InvalidMessage(f"there is no robot {named}; there are {', '.join(map(str, robots))}")
        return robots if named is None else [named]

    def clients(self, viewer: Viewer) -> ViewerClients:
        """Return the connections of a viewer."""
        return self._clients[viewer]

    def _refuse(self, viewer: Viewer, number: int | None, error: str) -> None:
        viewer.notify(messages.encode_message("answer", id=number, ok=False, error=error))

    def _internal_error(self, viewer: Viewer, number: int | None) -> Callable[[Exception], None]:
        """Return a function that answers a viewer's message with an unexpected error."""
        return lambda error: self._refuse(viewer, number, f"internal error, see the daemon's log: {error!r}")

    def _send_changed(self, kind: str, robots: Mapping[int, object]) -> None:
        """Send values by robot to all pages if they have changed."""
        if robots != self._sent[kind]:
            self._sent[kind] = robots
            self.broadcaster.notify(messages.encode_message(kind, robots=robots))

    def _programs(self) -> dict[int, list[str]]:
        """Return the names of the clients of each robot that has any."""
        programs: dict[int, list[str]] = {}
        for connection in self.daemon.connections:
            robot_id = connection.session.context.robot_id
            if robot_id is not None and connection.is_connected and connection.line != ViewerClient.line:
                programs.setdefault(robot_id, []).append(connection.session.name)
        return programs

    def _send_localizers(self) -> None:
        self.broadcaster.notify(messages.encode_message("localizers", robots=self.localizers.as_dict()))

    def _send_traffic(self) -> None:
        recorder = self.traffic_monitor
        rows, missed, recorder.missed = recorder.rows(), recorder.missed, 0
        if rows:
            self.broadcaster.notify(messages.encode_message("traffic", rows=rows, missed=missed), traffic=True)

    def _wire_state_of(self, name: str) -> WireState | None:
        """Return a connection's wire state between two of its requests, else None."""
        for connection in self.daemon.connections:
            session = connection.session
            if session.name == name:
                return None if session.unfinished or session.ready or session.waiting else session.context.wire_state
        return None

    def _accept_pose_clicks(self) -> None:
        self.daemon.emulator.pose_requests.open = any(viewer.may_act for viewer in self.broadcaster.viewers)


def _replier(viewer: Viewer, number: int) -> Callable[[Answer], None]:
    """Return a function that sends a viewer the reply to its message of this number."""
    return lambda answer: viewer.notify(messages.encode_message("answer", id=number, **answer))


TIMEOUT_S: Final = 60.0
"""The largest map takes some seconds."""


def adjust_world(text: str, lengths: Sequence[Tape], program: Sequence[str] = NOMAD) -> dict[str, Any]:
    """Return the answer to a page: the text of a world file after the adjustment, or an error."""
    with tempfile.TemporaryDirectory(prefix="nserver-") as folder:
        before, after = Path(folder, "world.toml"), Path(folder, "adjusted.toml")
        before.write_text(text, encoding="utf-8")
        command = [*program, "map", "edit", str(before), "--out", str(after), "--json"]
        for tape in lengths:
            (x1, y1), (x2, y2) = tape.ends
            # A value that begins with a minus would be taken for an option.
            command += ["--length", f" {x1!r},{y1!r}", f" {x2!r},{y2!r}", repr(tape.length)]
        command += ["--tape-std", repr(min(tape.std for tape in lengths))]
        try:
            ended = subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT_S, check=False)
        except (OSError, subprocess.TimeoutExpired) as error:
            return {"ok": False, "error": f"nomad map edit: {error}"}
        if ended.returncode:
            lines = ended.stderr.strip().splitlines() or [f"ended with {ended.returncode}"]
            return {"ok": False, "error": lines[-1].removeprefix("nomad: ").removeprefix("nomad map: ")}
        return {"ok": True, "text": after.read_text(encoding="utf-8"), **json.loads(ended.stdout)}
