"""Message types of ROS 2 for Cyclone DDS, compared with rosbags' CDR."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.interfaces import Nodetype

from nclient.recording import ros_messages
from nclient.recording.ros_messages import FieldType, MessageBuilder
from nserver_emu.ros import topics
from nserver_emu.ros.dds import RosTypes, topic_in_dds
from nserver_emu.ros.options import DISTROS
from worlds.robots import N150

JAZZY = RosTypes("jazzy")
TYPES = sorted({*topics.topic_types({1: N150.ring}).values(), *topics.command_types([1]).values(), ros_messages.TEXT})
# NaN is drawn as one fixed value, since encoders may write other bits of NaN.
NUMBERS: dict[str, Any] = {
    "bool": st.booleans(), "int8": st.integers(-128, 127), "uint8": st.integers(0, 255),
    "int32": st.integers(-(2**31), 2**31 - 1), "uint32": st.integers(0, 2**32 - 1),
    "float32": st.floats(width=32, allow_nan=False) | st.just(math.nan),
    "float64": st.floats(allow_nan=False) | st.just(math.nan),
    "string": st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=9),
}  # fmt: skip


def values_of(types: RosTypes, field: FieldType) -> Any:
    match field:
        case Nodetype.BASE, (name, _):
            return NUMBERS[name]
        case Nodetype.NAME, name:
            return messages_of(types, name)
        case Nodetype.ARRAY, (item, length):
            # Four values, repeated: 36 of them are slow to draw.
            return st.lists(values_of(types, item), min_size=4, max_size=4).map(lambda few: (few * length)[:length])
        case _, (item, _):
            return st.lists(values_of(types, item), max_size=3)
    raise AssertionError(field)


def messages_of(types: RosTypes, name: str) -> Any:
    return st.fixed_dictionaries({field: values_of(types, kind) for field, kind in types.store.fielddefs[name][1]})


def cdr_by_rosbags(types: RosTypes, name: str, message: dict[str, Any]) -> bytes:
    store = types.store
    built = MessageBuilder(store, store.types.__getitem__, np.array).build(name, message)
    return bytes(store.serialize_cdr(built, name))


@pytest.mark.parametrize("name", TYPES)
@settings(max_examples=20, deadline=None)
@given(data=st.data())
def test_bytes_are_those_of_rosbags(name: str, data: st.DataObject) -> None:
    message = data.draw(messages_of(JAZZY, name))
    # Version 1 of XCDR, which ROS 2 uses.
    written = JAZZY.builder.build(name, message).serialize(use_version_2=False)
    assert written == cdr_by_rosbags(JAZZY, name, message)
    again = JAZZY.dds_type(name).deserialize(written)
    assert again.serialize(use_version_2=False) == written


@pytest.mark.long
@pytest.mark.parametrize("distro", DISTROS)
def test_every_distribution_has_the_types(distro: str) -> None:
    types = RosTypes(distro)
    for name in TYPES:
        # Fields that are left out are 0 or empty.
        assert types.builder.build(name, {}).serialize(use_version_2=False) == cdr_by_rosbags(types, name, {})
    fields = [name for name, _ in types.store.fielddefs[ros_messages.RANGE][1]]
    assert ("variance" in fields) == (distro != "humble")


def test_names_are_those_of_ros_2() -> None:
    assert JAZZY.dds_type(ros_messages.ODOMETRY).__idl_typename__ == "nav_msgs.msg.dds_.Odometry_"
    # ROS 2 prefixes topics with rt; a name part must not begin with a digit.
    assert topic_in_dds("/robot1/odom") == "rt/robot1/odom"
    assert topic_in_dds("/robot12/sonar/3") == "rt/robot12/sonar_3"


def test_hash_is_that_of_ros_2() -> None:
    """The hash of std_msgs/msg/String in ROS 2."""
    known = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
    assert JAZZY.type_hash("std_msgs/msg/String") == known
