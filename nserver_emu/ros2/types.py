"""ROS 2 message types for Cyclone DDS, made from the type descriptions of rosbags.

    nav_msgs/msg/Odometry ──> class Odometry_, in DDS nav_msgs::msg::dds_::Odometry_

Names are mangled as ROS 2 does it; types are final, so that their XCDR1 is the CDR of ROS 2.
"""

import re
from functools import cached_property
from typing import Any, Final

from cyclonedds.idl import IdlStruct, annotations, make_idl_struct, types
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_typestore

from nclient.recording.ros_types import FieldType, MessageBuilder

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
            self._made[name] = annotations.final(made)
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
