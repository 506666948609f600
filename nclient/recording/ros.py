"""Drives as ROS messages in MCAP files and ROS 1 and 2 bags (extra `ros`: mcap, rosbags).

    /robot1/odom      nav_msgs/Odometry       robot1/odom -> robot1/base_link, metres, radians (REP-103, REP-105)
    /robot1/sonar     sensor_msgs/LaserScan   frame robot1/turret, +inf for no echo, -inf for too near (REP-117)
    /robot1/bumpers   std_msgs/UInt32         bits of State[33]
    /robot1/battery   sensor_msgs/BatteryState
    /tf               tf2_msgs/TFMessage
    /tf_static        tf2_msgs/TFMessage      places of the sonars, if known
    /nomad/recording  std_msgs/String         lines of the recording that the drive comes from, to convert it back

Read are one topic of nav_msgs/Odometry or geometry_msgs/PoseStamped and one of sensor_msgs/LaserScan, whatever their
names, or with `fields` numbers of any message. Times of messages are those of the log.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

from mcap.reader import SeekingReader
from mcap.writer import Writer as McapWriter
from rosbags.highlevel import AnyReader
from rosbags.rosbag1 import Writer as Bag1Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Bag2Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from nclient.errors import RecordingError, suggest
from nclient.recording import ros_messages
from nclient.recording.drive import RING, Drive, Sample, drive_of_recording
from nclient.recording.format import parse_recording
from nclient.recording.ros_messages import BATTERY, NUMBER, ODOMETRY, SCAN, TF, TF_STATIC, TRANSFORMS, MessageBuilder

POSE: Final = "geometry_msgs/msg/PoseStamped"
TRAFFIC: Final = "/nomad/recording"
"""Topic of the lines of a recording."""
_ROBOT: Final = "robot1"
_BUMPERS, _SONAR = f"/{_ROBOT}/bumpers", f"/{_ROBOT}/sonar"
_BATTERIES: Final = (f"/{_ROBOT}/battery/cpu", f"/{_ROBOT}/battery/motors")
_OWN: Final = {TRAFFIC: ros_messages.TEXT, _BUMPERS: NUMBER, TF: TRANSFORMS, TF_STATIC: TRANSFORMS,
               **dict.fromkeys(_BATTERIES, BATTERY)}  # fmt: skip
"""Topics of `write` that others do not have, with their types."""
MAX_RECORD_BYTES: Final = 1 << 28
"""Longer records of a MCAP file are refused: a damaged length must not take all memory. Chunks have some MB."""


class Message(NamedTuple):
    """A message to write: time in ns, topic, type, and its fields."""

    time_ns: int
    topic: str
    type: str
    content: ros_messages.Message


# -- writing ----------------------------------------------------------------------------------------------------------


def write(drive: Drive, path: Path, name: str) -> None:
    """Write a drive as MCAP, ROS 1 bag or ROS 2 bag. Raises RecordingError, or OSError."""
    earliest_s = drive.start_s + min(sample.time_s for sample in drive.samples)
    if earliest_s < 0:
        raise RecordingError(f"{path}: cannot be written: bags and MCAP have no time before 0, here {earliest_s:g} s")
    try:
        _write(drive, path, name)
    except OSError:
        raise
    except Exception as error:  # writers of other packages raise any type, such as struct.error
        raise RecordingError(f"{path}: cannot be written ({type(error).__name__}: {error})") from error


def _write(drive: Drive, path: Path, name: str) -> None:
    if name == "ROS 1 bag":
        store = get_typestore(Stores.ROS1_NOETIC)
        store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", TRANSFORMS))
        with Bag1Writer(path) as bag:
            _write_bag(bag, drive, store, store.serialize_ros1)
        return
    store = get_typestore(Stores.ROS2_HUMBLE)
    if name == "ROS 2 bag":
        with Bag2Writer(path, version=8, storage_plugin=StoragePlugin.SQLITE3) as bag2:
            _write_bag(bag2, drive, store, store.serialize_cdr)
        return
    _write_mcap(drive, path, store)


def _write_bag(bag: Any, drive: Drive, store: Any, serialize: Callable[[Any, str], Any]) -> None:
    topics: dict[str, Any] = {}
    builder = _builder(store)
    for message in _messages(drive):
        if message.topic not in topics:
            topics[message.topic] = bag.add_connection(message.topic, message.type, typestore=store)
        data = serialize(builder.build(message.type, message.content), message.type)
        bag.write(topics[message.topic], message.time_ns, data)


def _write_mcap(drive: Drive, path: Path, store: Any) -> None:
    with path.open("wb") as file:
        writer = McapWriter(file)
        writer.start(profile="ros2", library="nomad-nserver")
        channels: dict[str, int] = {}
        builder = _builder(store)
        for sequence, message in enumerate(_messages(drive)):
            if message.topic not in channels:
                text, _ = store.generate_msgdef(message.type, ros_version=2)
                schema = writer.register_schema(message.type, "ros2msg", text.encode())
                channels[message.topic] = writer.register_channel(message.topic, "cdr", schema)
            data = bytes(store.serialize_cdr(builder.build(message.type, message.content), message.type))
            writer.add_message(channels[message.topic], message.time_ns, data, message.time_ns, sequence)
        writer.finish()  # type: ignore[no-untyped-call]


def _builder(store: Any) -> MessageBuilder:
    """Return what makes messages of rosbags, whose arrays are numpy's."""
    import numpy as np

    return MessageBuilder(store, store.types.__getitem__, np.array)


def _messages(drive: Drive) -> Iterator[Message]:
    """Yield the messages of a drive in the order of time, the lines of its recording first."""
    start_ns, ring_m = round(drive.start_s * 1e9), drive.ring_m
    first_ns = start_ns + round(drive.samples[0].time_s * 1e9)
    for line in drive.traffic:
        yield Message(first_ns, TRAFFIC, ros_messages.TEXT, {"data": line})
    if ring_m:
        mounts = [(ring_m * math.cos(angle), ring_m * math.sin(angle), angle) for angle in drive.directions_rad]
        frames = ros_messages.sonar_frames(first_ns, _ROBOT, mounts)
        yield Message(first_ns, TF_STATIC, TRANSFORMS, {"transforms": frames})
    for sample in drive.samples:
        yield from sample_messages(sample, drive.directions_rad, start_ns, ring_m)


def sample_messages(sample: Sample, directions: Sequence[float], start_ns: int, ring_m: float) -> Iterator[Message]:
    """Yield the messages of one sample."""
    time_ns = start_ns + round(sample.time_s * 1e9)
    at = sample.x_m, sample.y_m, sample.heading_rad
    # 1. Pose and velocity by odometry, and frames: the turret turns on the base.
    moved = ros_messages.odometry(time_ns, _ROBOT, at, sample.speed_m_s, sample.turn_rad_s)
    yield Message(time_ns, f"/{_ROBOT}/odom", ODOMETRY, moved)
    turret = sample.heading_rad if sample.turret_rad is None else sample.turret_rad
    frames = ros_messages.moving_frames(time_ns, _ROBOT, at, turret - sample.heading_rad)
    yield Message(time_ns, TF, TRANSFORMS, {"transforms": frames})
    # 2. Bumpers and battery, before the sonars: a scan completes the sample when it is read.
    yield Message(time_ns, _BUMPERS, NUMBER, {"data": sample.bumpers})
    if sample.volts:
        for topic, volts in zip(_BATTERIES, sample.volts, strict=True):
            yield Message(time_ns, topic, BATTERY, ros_messages.battery(time_ns, "", volts, topic.rpartition("/")[2]))
    # 3. Sonars.
    if sample.ranges_m:
        ranges_m = [ros_messages.range_m(one) for one in sample.ranges_m] if ring_m else sample.ranges_m
        scan = ros_messages.scan(time_ns, _ROBOT, ranges_m, directions, ring_m)
        yield Message(time_ns, _SONAR, SCAN, scan)


# -- reading ----------------------------------------------------------------------------------------------------------


def read(path: Path, name: str, fields: Sequence[str]) -> Drive:
    """Read a drive from MCAP or a bag, as `name` says; `fields` as of `convert.read_drive`."""
    builder = _Builder([_Field.parse(text) for text in fields])
    try:
        for topic, kind, time_ns, message in _read_messages(path, name, builder):
            builder.add(topic, kind, time_ns, message)
    except RecordingError:
        raise
    except Exception as error:  # readers of other packages raise any type
        raise RecordingError(f"{path}: cannot be read ({type(error).__name__}: {error})") from error
    if builder.lines:
        return drive_of_recording(parse_recording("\n".join(builder.lines) + "\n", str(path)), builder.lines)
    return builder.drive()


def _read_messages(path: Path, name: str, builder: "_Builder") -> Iterator[tuple[str, str, int, Any]]:
    """Yield topic, type, time in ns and content of the messages that the builder wants."""
    if name == "ROS 1 bag" and path.suffix != ".bag":
        raise RecordingError(f"{path}: is a ROS 1 bag; give it a name that ends in .bag")
    if name != "MCAP":
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            builder.choose((connection.topic, connection.msgtype) for connection in reader.connections)
            for connection, time_ns, data in reader.messages():
                if builder.wants(connection.topic, connection.msgtype):
                    content = reader.deserialize(data, connection.msgtype)
                    yield connection.topic, connection.msgtype, time_ns, content
        return
    store = get_typestore(Stores.ROS2_HUMBLE)
    with path.open("rb") as file:
        mcap = SeekingReader(file, record_size_limit=MAX_RECORD_BYTES)
        # A file that was not closed has no summary: the first topics are chosen as they come.
        if summary := mcap.get_summary():
            builder.choose((channel.topic, summary.schemas[channel.schema_id].name)
                           for channel in summary.channels.values() if channel.schema_id in summary.schemas)
        for schema, channel, message in mcap.iter_messages():
            if schema is None or not builder.wants(channel.topic, schema.name):
                continue
            if channel.message_encoding != "cdr":
                raise RecordingError(f"{path}: {channel.topic} is encoded as {channel.message_encoding}; "
                                     "CDR of ROS 2 is read")
            if schema.name not in store.types:
                store.register(get_types_from_msg(schema.data.decode(), schema.name))
            yield channel.topic, schema.name, message.log_time, store.deserialize_cdr(message.data, schema.name)


class _Field(NamedTuple):
    """A number of a message that is read as a column: `x_m=/state:raw.0`."""

    column: str
    topic: str
    place: tuple[str, ...]

    @classmethod
    def parse(cls, text: str) -> "_Field":
        column, _, source = text.partition("=")
        topic, _, place = source.partition(":")
        columns = ("x_m", "y_m", "heading_rad", "qx", "qy", "qz", "qw")
        if (column not in columns and not _is_sonar(column)) or not topic or not place:
            raise RecordingError(f"--field {text}: expected COLUMN=TOPIC:PLACE, such as x_m=/state:raw.0; columns are "
                                 f"{', '.join(columns)}, sonar_0_m, sonar_1_m, ...")
        return cls(column, topic, tuple(place.split(".")))

    def value(self, message: Any) -> float:
        for part in self.place:
            try:
                message = message[int(part)] if part.isdecimal() else getattr(message, part)
            except (AttributeError, IndexError, TypeError):
                raise RecordingError(f"--field {self.column}: {self.topic} has no {'.'.join(self.place)}") from None
        try:
            return float(message)
        except (TypeError, ValueError):
            place = ".".join(self.place)
            raise RecordingError(f"--field {self.column}: {place} of {self.topic} is no number") from None


def _is_sonar(column: str) -> bool:
    return column.startswith("sonar_") and column.endswith("_m") and column[6:-2].isdecimal()


class _Builder:
    """Puts messages together to samples: one at each scan, or at each pose if there are no scans."""

    def __init__(self, fields: Sequence[_Field]) -> None:
        self._fields = fields
        self._poses = self._scans = ""
        self._frames_seen = self._has_turret = False
        self._values: dict[str, float] = {}
        self._pose: Sample | None = None
        self._volts: dict[str, float] = {}
        self._found: list[tuple[int, Sample, bool]] = []
        self._directions: tuple[float, ...] = ()
        self._ignored: dict[str, str] = {}
        self._early = self._odd = 0
        self._ring_m = 0.0
        self.lines: list[str] = []

    def choose(self, topics: Iterable[tuple[str, str]]) -> None:
        """Choose the topic of the poses and that of the scans: of this project, else odometry before others, by name.

        Two robots, or two lasers, would be mixed into one drive.
        """
        found = sorted(topics, key=lambda one: (not one[0].startswith(f"/{_ROBOT}/"), one[1] != ODOMETRY, one[0]))
        self._poses = next((topic for topic, kind in found if kind in (ODOMETRY, POSE)), "")
        self._scans = next((topic for topic, kind in found if kind == SCAN), "")

    def wants(self, topic: str, kind: str) -> bool:
        """Return True if messages of the topic are read; the others are named as left out."""
        if self._fields:
            is_read = any(field.topic == topic for field in self._fields)
        elif kind in (ODOMETRY, POSE):
            self._poses = self._poses or topic
            is_read = topic == self._poses
        elif kind == SCAN:
            self._scans = self._scans or topic
            is_read = topic == self._scans
        else:
            is_read = _OWN.get(topic) == kind
        if not is_read:
            self._ignored[topic] = kind
        return is_read

    def add(self, topic: str, kind: str, time_ns: int, message: Any) -> None:
        if self._fields:
            self._add_fields(topic, time_ns, message)
        elif topic == TRAFFIC:
            self.lines.append(message.data)
        elif kind == ODOMETRY:
            twist = message.twist.twist
            pose = _pose(message.pose.pose)._replace(speed_m_s=twist.linear.x, turn_rad_s=twist.angular.z)
            self._set_pose(time_ns, pose)
        elif kind == POSE:
            self._set_pose(time_ns, _pose(message.pose))
        elif topic == TF_STATIC:
            # All sonars have the same distance from the axis.
            own = (one for one in message.transforms if one.child_frame_id == f"{_ROBOT}/sonar_0")
            self._ring_m = next((one.transform.translation.x for one in own), self._ring_m)
        elif kind == TRANSFORMS:
            self._frames_seen = True
            for transform in message.transforms:
                if transform.child_frame_id == f"{_ROBOT}/turret" and self._pose:
                    self._has_turret = True
                    angle = _angle(transform.transform.rotation)
                    self._pose = self._pose._replace(turret_rad=self._pose.heading_rad + angle)
                    self._replace_last()
        elif topic == _BUMPERS and self._pose:
            self._pose = self._pose._replace(bumpers=message.data)
            self._replace_last()
        elif kind == BATTERY and self._pose:
            self._volts[topic] = message.voltage
            if len(self._volts) == len(_BATTERIES):
                cpu, motors = (self._volts[one] for one in _BATTERIES)
                self._pose = self._pose._replace(volts=(cpu, motors))
        elif kind == SCAN:
            self._add_scan(time_ns, message, self._ring_m if topic == _SONAR else 0.0)

    def _add_scan(self, time_ns: int, message: Any, ring_m: float) -> None:
        count, step = len(message.ranges), message.angle_increment
        directions = tuple(message.angle_min + k * step for k in range(count))
        # A scan has angles in single precision: those of a Nomad's ring are known exactly.
        if count == len(RING) and not message.angle_min and math.isclose(step, RING[1], rel_tol=1e-5):
            directions = RING
        # The first scan decides the directions of the drive.
        self._directions = self._directions or directions
        ends = zip(directions[:1] + directions[-1:], self._directions[:1] + self._directions[-1:], strict=False)
        if count != len(self._directions) or not all(math.isclose(*both, abs_tol=1e-3) for both in ends):
            self._odd += 1
            return
        limits_m = message.range_min, message.range_max
        self._add_ranges(time_ns, tuple(_range(value, *limits_m) - ring_m for value in message.ranges))

    def _set_pose(self, time_ns: int, pose: Sample) -> None:
        before = self._pose
        if before is not None and before.turret_rad is not None:
            # Until the next transform the turret keeps its direction on the base.
            pose = pose._replace(turret_rad=pose.heading_rad + before.turret_rad - before.heading_rad)
        self._pose = pose
        self._found.append((time_ns, self._pose, False))

    def _replace_last(self) -> None:
        if self._found and self._pose and not self._found[-1][2]:
            self._found[-1] = (self._found[-1][0], self._pose, False)

    def _add_ranges(self, time_ns: int, ranges: tuple[float, ...]) -> None:
        if self._pose is None:
            self._early += 1
        else:
            self._found.append((time_ns, self._pose._replace(ranges_m=ranges), True))

    def _add_fields(self, topic: str, time_ns: int, message: Any) -> None:
        new = [field for field in self._fields if field.topic == topic]
        for field in new:
            self._values[field.column] = field.value(message)
        values = self._values
        # Until every column has had a message there is no pose to begin with.
        if len(values) < len({field.column for field in self._fields}):
            self._early += any(_is_sonar(field.column) for field in new)
            return
        heading = values.get("heading_rad", 0.0)
        if "qw" in values:
            heading = _angle_of(*(values.get(name, 0.0) for name in ("qx", "qy", "qz", "qw")))
        self._pose = Sample(0.0, values.get("x_m", 0.0), values.get("y_m", 0.0), heading)
        sonars = sorted((name for name in values if _is_sonar(name)), key=lambda name: int(name[6:-2]))
        wanted = {field.column for field in self._fields if _is_sonar(field.column)}
        # A sample is complete with the message that has the sonars, or any where there are none.
        if any(_is_sonar(field.column) for field in new) or not wanted:
            self._directions = tuple(math.tau * k / len(sonars) for k in range(len(sonars)))
            self._add_ranges(time_ns, tuple(values[name] for name in sonars))

    def drive(self) -> Drive:
        missing = [field for field in self._fields if field.column not in self._values]
        if missing:
            raise RecordingError(f"--field {missing[0].column}: there is no message of {missing[0].topic}"
                                 f"{suggest(missing[0].topic, self._ignored)}")
        with_ranges = any(is_scan for _, _, is_scan in self._found)
        found = [(time_ns, sample) for time_ns, sample, is_scan in self._found if is_scan or not with_ranges]
        start_ns = found[0][0] if found and found[0][0] > 10**18 else 0
        samples = [sample._replace(time_s=(time_ns - start_ns) / 1e9) for time_ns, sample in found]
        drive = Drive(samples, self._directions or RING, self._ring_m, start_ns / 1e9)
        if self._frames_seen and not self._has_turret:
            self._ignored[TF] = TRANSFORMS
        drive.omitted += [f"{topic} ({kind})" for topic, kind in self._ignored.items()]
        if self._odd:
            drive.omitted.append(f"{self._odd} scans with other directions than the first")
        if self._early:
            drive.omitted.append(f"{self._early} scans before the first pose")
        return drive


def _pose(pose: Any) -> Sample:
    return Sample(0.0, pose.position.x, pose.position.y, _angle(pose.orientation))


def _angle(q: Any) -> float:
    return _angle_of(q.x, q.y, q.z, q.w)


def _angle_of(x: float, y: float, z: float, w: float) -> float:
    """Return the heading of a quaternion in radians."""
    return math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


def _range(value: float, min_m: float, max_m: float) -> float:
    """Return a reading in metres; inf for none (REP-117: +inf; older drivers: NaN, or beyond the maximum).

    One that is too near (-inf) reads as the minimum.
    """
    if value == -math.inf:
        return float(min_m)
    return float(value) if 0 <= value <= max_m else math.inf
