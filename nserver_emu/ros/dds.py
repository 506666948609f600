"""Robots of a daemon in a DDS domain, as a node of ROS 2 publishes and subscribes them.

    RobotReader ──> MessageBuilder ──> writers of /robotN/odom, /robotN/sonar, /tf, ... that have a subscriber
    readers of /robotN/cmd_vel ──> a driver for each publisher ──> ViewerClients, as a page or rosbridge client drives

Velocities must be repeated: the robot stops DRIVE_TIMEOUT_S after the last one, and at once when its publisher leaves.

Types are made from the descriptions of rosbags: nav_msgs/msg/Odometry is nav_msgs::msg::dds_::Odometry_ in DDS. They
are final, so that their XCDR1 is the CDR of ROS 2.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import re
from collections.abc import AsyncIterator
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any, Final

from cyclonedds.core import DDSException
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.idl import IdlStruct, make_idl_struct, types
from cyclonedds.idl import annotations as idl_annotations
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_typestore

from nclient.errors import ConnectionLost, install_command
from nclient.recording.ros_messages import MAP, TF, TF_STATIC, FieldType, Message, MessageBuilder
from nserver_emu.ros import topics
from nserver_emu.ros.topics import PERIOD_S, Estimates, RobotReader, loop_time, map_message, rings_of
from nserver_emu.server.daemon import Daemon
from nserver_emu.viewer.clients import ErrorBoundary, ViewerClients
from worlds.world import World

log = logging.getLogger(__name__)

COMMAND_PERIOD_S: Final = 0.02
"""Interval at which velocities are read."""
MAX_COMMANDS: Final = 10
"""Velocities of a robot between two readings of them; only the latest of each publisher counts."""
_RELIABLE: Final = Policy.Reliability.Reliable(duration(milliseconds=1))
_CDR: Final = Policy.DataRepresentation(use_cdrv0_representation=True)
_STATE = Qos(_RELIABLE, Policy.History.KeepLast(10), _CDR)
_SENSOR = Qos(Policy.Reliability.BestEffort, Policy.History.KeepLast(5), _CDR)
_FRAMES = Qos(_RELIABLE, Policy.History.KeepLast(100), _CDR)
_LATCHED = Qos(_RELIABLE, Policy.Durability.TransientLocal, Policy.History.KeepLast(1), _CDR)
# Best effort: reliable and unreliable publishers match.
_COMMAND = Qos(Policy.Reliability.BestEffort, Policy.History.KeepLast(MAX_COMMANDS), _CDR)


@dataclass(slots=True)
class Driver:
    """A publisher of velocities, and the last error that it caused."""

    clients: ViewerClients
    error: str = ""


class Ros2Node:
    """Participant of a DDS domain with the topics of a daemon's robots.

    Parameters
    ----------
    daemon : the robots.
    types : message types.
    domain : ROS_DOMAIN_ID.
    config : configuration of Cyclone DDS in XML; None for that of CYCLONEDDS_URI.
    estimates : estimates that localizers publish.
    has_map : the world is that of the robots.
    """

    def __init__(self, daemon: Daemon, types: RosTypes, domain: int, config: str | None, estimates: Estimates, *,
                 has_map: bool) -> None:
        self._daemon = daemon
        self._types = types
        self._error_boundary = ErrorBoundary("ros2")
        robots = list(daemon.emulator.simulation.robots)
        self._domain = None if config is None else Domain(domain, config)
        self._participant = DomainParticipant(domain, Qos(Policy.Userdata(b"enclave=/;")))
        # 1. What is published; /map of a robot elsewhere is not known.
        published = topics.topic_types(rings_of(daemon))
        if not has_map:
            del published[MAP]
        self._kinds = published
        self._writers = {name: self._writer(name, kind) for name, kind in published.items()}
        # 2. What is subscribed, and its publishers by robot and handle.
        commands = topics.command_types(robots)
        self._readers = {robot: self._reader(*one) for robot, one in zip(robots, commands.items(), strict=True)}
        self._drivers: dict[tuple[int, int], Driver] = {}
        self._rejected: set[tuple[int, int]] = set()
        self._drivers_made = 0
        self._robots = RobotReader(daemon, "ros2", self._error_boundary, self._publish, estimates)
        self._world: World | None = None
        self._tasks: list[asyncio.Task[None]] = []

    def start(self) -> None:
        """Start publishing, in the running event loop."""
        self._write(TF_STATIC, self._robots.static_frames())
        self._tasks.append(asyncio.create_task(self._run_clock()))
        if MAP in self._writers:
            self._tasks.append(asyncio.create_task(self._run_map()))

    async def close(self) -> None:
        """Stop; robots that are driven from here stop, and the topics vanish for others."""
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        for driver in self._drivers.values():
            driver.clients.close()
        self._drivers.clear()
        self._robots.close()
        # Entities of DDS end with their last reference, the participant last.
        self._writers.clear()
        self._readers.clear()
        del self._participant
        self._domain = None

    # -- publishing

    def _writer(self, name: str, kind: str) -> DataWriter[Any]:
        match name, kind:
            case ("/tf", _):
                qos = _FRAMES
            case ("/map" | "/tf_static", _):
                qos = _LATCHED
            case (_, "sensor_msgs/msg/LaserScan" | "sensor_msgs/msg/Range"):
                qos = _SENSOR
            case _:
                qos = _STATE
        return DataWriter(self._participant, self._topic(name, kind), qos + self._user_data(kind))

    def _topic(self, name: str, kind: str) -> Topic[Any]:
        return Topic(self._participant, topic_in_dds(name), self._types.dds_type(kind))

    def _user_data(self, kind: str) -> Qos:
        return Qos(Policy.Userdata(f"typehash={self._types.type_hash(kind)};".encode()))

    def _publish(self, topic: str, message: Message) -> None:
        """Write a message if the topic has a subscriber."""
        if self._has_subscriber(topic):
            self._write(topic, message)

    def _write(self, topic: str, message: Message) -> None:
        with self._error_boundary.guard(f"writing {topic}"):
            self._writers[topic].write(self._types.builder.build(self._kinds[topic], message))

    def _has_subscriber(self, topic: str) -> bool:
        return bool(self._writers[topic].get_publication_matched_status().current_count)

    def _is_watched(self, robot: int) -> bool:
        """Return True if a topic that comes from the state of the robot has a subscriber."""
        own = f"/robot{robot}/"
        return any(self._has_subscriber(topic) for topic in self._writers if topic == TF or topic.startswith(own))

    # -- driving

    def _reader(self, name: str, kind: str) -> DataReader[Any]:
        return DataReader(self._participant, self._topic(name, kind), _COMMAND + self._user_data(kind))

    def _take(self, robot: int, now: float) -> None:
        """Carry out the velocities that have come for a robot, and stop it for publishers that have left."""
        reader = self._readers[robot]
        # 1. The latest message of each publisher. What waited for longer is history.
        latest: dict[int, Any] = {}
        for sample in reader.take(MAX_COMMANDS):
            if sample.sample_info.valid_data:
                latest[sample.sample_info.publication_handle] = sample
        mine = [handle for number, handle in self._drivers if number == robot]
        if not latest and not mine:
            return
        # 2. Publishers that are still there drive; those that have left stop what they moved.
        # Handles of samples are unsigned, those of publications signed.
        matched = {handle % 2**64 for handle in reader.get_matched_publications()}
        for handle, twist in latest.items():
            if handle in matched:
                self._drive(robot, handle, twist, now)
        for handle in set(mine) - matched:
            self._drivers.pop((robot, handle)).clients.close()
        self._rejected -= {one for one in self._rejected if one[0] == robot and one[1] not in matched}

    def _drive(self, robot: int, handle: int, twist: Any, now: float) -> None:
        driver = self._drivers.get((robot, handle))
        if driver is None:
            limit = self._daemon.admission.limits.viewers
            if len(self._drivers) >= limit:
                # Once for each publisher, which repeats its messages.
                if (robot, handle) not in self._rejected:
                    self._rejected.add((robot, handle))
                    reason = f"more than {limit} publishers of velocities (--limit-viewers)"
                    self._daemon.admission.reject("DDS", reason)
                return
            self._rejected.discard((robot, handle))
            self._drivers_made += 1
            clients = ViewerClients(self._daemon, f"ros2 {self._drivers_made}", self._error_boundary)
            driver = self._drivers[robot, handle] = Driver(clients)

        def log_error(error: str) -> None:
            # A publisher repeats its messages; DDS cannot answer it.
            if error and error != driver.error:
                log.warning("/robot%d/cmd_vel of %s: %s", robot, driver.clients.name, error)
            driver.error = error

        is_differential = self._daemon.emulator.simulation.robots[robot].model.track_in is not None
        try:
            args = topics.velocities(asdict(twist), is_differential)
        except ValueError as error:
            log_error(str(error))
            return
        driver.clients.drive(robot, args, now, lambda answer: log_error(answer.get("error", "")))

    # -- tasks

    async def _run_clock(self) -> None:
        due = loop_time()
        while True:
            await asyncio.sleep(COMMAND_PERIOD_S)
            now = loop_time()
            # 1. Velocities, and robots whose driver is silent.
            for robot in self._readers:
                with self._error_boundary.guard("velocities"):
                    self._take(robot, now)
            for driver in tuple(self._drivers.values()):
                driver.clients.tick(now)
            # 2. Readings of robots that are watched; a longer delay is not made up for.
            if now >= due:
                due = max(due + PERIOD_S, now)
                for robot in self._readers:
                    with self._error_boundary.guard("reading a robot"):
                        if self._is_watched(robot):
                            self._robots.read(robot)

    async def _run_map(self) -> None:
        """Write the map, and again when the world has changed; made in a thread, since it takes a second."""
        while True:
            world = self._daemon.emulator.simulation.world
            if world is not self._world:
                self._world = world
                try:
                    self._write(MAP, await asyncio.to_thread(map_message, world))
                except ImportError as error:
                    log.warning("/map: %s; install it: %s", error, install_command("maps"))
                    return
                except ValueError as error:
                    log.warning("/map: %s", error)
            await asyncio.sleep(PERIOD_S)


@contextlib.asynccontextmanager
async def running_node(daemon: Daemon, distro: str, domain: int, config: str | None, estimates: Estimates, *,
                       has_map: bool) -> AsyncIterator[None]:
    """Publish and subscribe a daemon's robots.

    Raises
    ------
    ConnectionLost
        If Cyclone DDS cannot use the network interface or the domain.
    """
    try:
        node = Ros2Node(daemon, RosTypes(distro), domain, config, estimates, has_map=has_map)
    except DDSException as error:
        raise ConnectionLost(f"--ros2: Cyclone DDS cannot use domain {domain} on this network interface ({error.msg}); "
                             "name one of this machine, or correct CYCLONEDDS_URI") from error  # fmt: skip
    try:
        node.start()
        yield
    finally:
        await node.close()


_BASE: Final[dict[str, Any]] = {
    "bool": bool, "string": str, "int8": types.int8, "uint8": types.uint8, "int32": types.int32,
    "uint32": types.uint32, "float32": types.float32, "float64": types.float64,
}  # fmt: skip


class RosTypes:
    """Types of a distribution of ROS 2, such as jazzy."""

    def __init__(self, distro: str) -> None:
        self.store = get_typestore(Stores[f"ROS2_{distro.upper()}"])
        self._made: dict[str, type[IdlStruct]] = {}

    @cached_property
    def builder(self) -> MessageBuilder:
        """Builder of messages from dictionaries."""
        return MessageBuilder(self.store, self.dds_type)

    def dds_type(self, name: str) -> type[IdlStruct]:
        """Return the class of a type such as nav_msgs/msg/Odometry."""
        if name not in self._made:
            package, _, short = name.rpartition("/")
            fields = {field: self._field(kind) for field, kind in self.store.fielddefs[name][1]}
            made = make_idl_struct(f"{short}_", f"{package.replace('/', '.')}.dds_.{short}_", fields)
            self._made[name] = idl_annotations.final(made)
        return self._made[name]

    def type_hash(self, name: str) -> str:
        """Return the hash of a type (REP-2011), which is in the user data of writers and readers."""
        return self.store.hash_rihs01(name)

    def _field(self, field: FieldType) -> Any:
        match field:
            case Nodetype.BASE, (name, _):
                return _BASE[name]
            case Nodetype.NAME, name:
                return self.dds_type(name)
            case Nodetype.ARRAY, (item, length):
                return types.array[self._field(item), length]
            case _, (item, _):
                return types.sequence[self._field(item)]
        raise AssertionError(field)


def topic_in_dds(topic: str) -> str:
    """Return the DDS name of a topic: rt/robot1/odom.

    ROS 2 allows no part of a name that begins with a digit: /robot1/sonar/3 is rt/robot1/sonar_3.
    """
    return f"rt{re.sub(r'/(?=[0-9])', '_', topic)}"
