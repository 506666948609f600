"""Programs on the other side of DDS, with Cyclone DDS alone: subscribers and publishers of ROS 2 topics."""

from __future__ import annotations

import os
from typing import Any

from cyclonedds._clayer import ddspy_take
from cyclonedds.core import InstanceState, SampleState, ViewState
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

from nserver_emu.ros.dds import RosTypes, topic_in_dds
from nserver_emu.ros.options import LOOPBACK, config_of

TYPES = RosTypes("jazzy")
RELIABLE = Qos(Policy.Reliability.Reliable(10**8), Policy.History.KeepLast(10),
               Policy.DataRepresentation(use_cdrv0_representation=True))  # fmt: skip
BEST_EFFORT = Qos(Policy.Reliability.BestEffort, Policy.History.KeepLast(10))
LATCHED = RELIABLE + Qos(Policy.Durability.TransientLocal)
_ANY = SampleState.Any | ViewState.Any | InstanceState.Any


def free_domain() -> int:
    """Return a domain of this process's own, as the tests run in several."""
    # Domains end at 232; processes of one machine rarely share one.
    return 1 + os.getpid() % 231


def twist(speed_m_s: float, turn_rad_s: float = 0.0) -> Any:
    message = {"linear": {"x": speed_m_s}, "angular": {"z": turn_rad_s}}
    return TYPES.builder.build("geometry_msgs/msg/Twist", message)


class OtherSide:
    """A participant of a domain; with `own_domain` it opens the domain, else this process has it already."""

    def __init__(self, domain: int, *, own_domain: bool = False) -> None:
        self.domain = Domain(domain, config_of(LOOPBACK)) if own_domain else None
        self.participant = DomainParticipant(domain)

    def _topic(self, name: str, kind: str) -> Topic[Any]:
        return Topic(self.participant, topic_in_dds(name), TYPES.dds_type(kind))

    def reader(self, name: str, kind: str, qos: Qos = RELIABLE) -> DataReader[Any]:
        return DataReader(self.participant, self._topic(name, kind), qos)

    def writer(self, name: str, kind: str = "geometry_msgs/msg/Twist", qos: Qos = RELIABLE) -> DataWriter[Any]:
        return DataWriter(self.participant, self._topic(name, kind), qos)


def take_bytes(reader: DataReader[Any]) -> list[bytes]:
    """Return the messages that have come, as they were sent."""
    return [data for data, info in ddspy_take(reader._ref, _ANY, 100) if info.valid_data]


def is_cdr(message: bytes, expected: bytes) -> bool:
    """Return True if a message is these bytes and those that fill its last word."""
    # CDR is padded to words of four bytes.
    return message == expected + bytes(-len(expected) % 4)
