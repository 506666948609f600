"""ROS messages of a robot as dictionaries, in one form for bags, MCAP, rosbridge and ROS 2 by DDS.

Metres, radians and frames of REP-103 and REP-105; +inf is no echo, -inf a wall nearer than a sonar measures (REP-117).
Fields are named as in ROS 2; those that are left out are 0 or empty. Times are Unix times in nanoseconds; `robot` is
the name that its frames begin with.

Messages as objects of a library, from the type descriptions of rosbags: the one table of ROS types.

A message is made by `MessageBuilder.build`:

    {"data": 3}, "std_msgs/msg/UInt32" ──> UInt32 of rosbags, or UInt32_ of Cyclone DDS
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

from nclient.protocol.types import M_PER_IN, MAX_SONAR_IN, MIN_SONAR_IN

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

Message = dict[str, Any]
Pose2 = tuple[float, float, float]
"""x and y in metres, direction in radians."""

ODOMETRY, SCAN, RANGE = "nav_msgs/msg/Odometry", "sensor_msgs/msg/LaserScan", "sensor_msgs/msg/Range"
NUMBER, BATTERY, TEXT = "std_msgs/msg/UInt32", "sensor_msgs/msg/BatteryState", "std_msgs/msg/String"
ESTIMATE, TWIST = "geometry_msgs/msg/PoseWithCovarianceStamped", "geometry_msgs/msg/Twist"
TRANSFORMS, GRID = "tf2_msgs/msg/TFMessage", "nav_msgs/msg/OccupancyGrid"
TF, TF_STATIC, MAP, MAP_FRAME = "/tf", "/tf_static", "/map", "map"
LIMITS_M: Final = (MIN_SONAR_IN * M_PER_IN, MAX_SONAR_IN * M_PER_IN)
"""Least and largest range of a Nomad's sonar."""
CONE_RAD: Final = math.radians(25.0)
_ULTRASOUND: Final = 0
_UNMEASURED: Final = ("temperature", "current", "charge", "capacity", "design_capacity", "percentage")
"""Numbers of a BatteryState that are NaN where they are not measured."""


def odometry(time_ns: int, robot: str, at: Pose2, speed_m_s: float, turn_rad_s: float) -> Message:
    """Return an Odometry; its covariances are unknown: zeros."""
    unknown = [0.0] * 36
    return {
        "header": header(time_ns, f"{robot}/odom"), "child_frame_id": f"{robot}/base_link",
        "pose": {"pose": pose(*at), "covariance": unknown},
        "twist": {"twist": {"linear": vector(speed_m_s), "angular": vector(z=turn_rad_s)}, "covariance": unknown},
    }  # fmt: skip


def range_m(reading_m: float, min_m: float = LIMITS_M[0]) -> float:
    """Return a reading by REP-117: the least that a sonar measures means that the wall may be nearer."""
    return reading_m if reading_m > min_m else -math.inf


def scan(time_ns: int, robot: str, ranges_m: Sequence[float], directions_rad: Sequence[float], ring_m: float,
         limits_m: tuple[float, float] = LIMITS_M) -> Message:
    """Return sonars as LaserScan, which has room for readings at equal angles only.

    Parameters
    ----------
    time_ns, robot : as for all messages.
    ranges_m : readings, which begin at the sonars.
    directions_rad : directions of the sonars.
    ring_m : distance of the sonars from the axis, where the ranges of the message begin, as its frame does.
    limits_m : least and largest range.
    """
    first = directions_rad[0]
    step = math.remainder(directions_rad[1] - first, math.tau) if len(directions_rad) > 1 else 0.0
    # Other sensors reach farther: beyond the maximum of a scan a reading is no echo.
    measured = [one for one in ranges_m if math.isfinite(one)]
    min_m, max_m = min((limits_m[0], *measured)), max((limits_m[1], *measured))
    return {"header": header(time_ns, f"{robot}/turret"), "angle_min": first,
            "angle_max": first + step * (len(directions_rad) - 1), "angle_increment": step, "time_increment": 0.0,
            "scan_time": 0.0, "range_min": min_m + ring_m, "range_max": max_m + ring_m,
            "ranges": [one + ring_m for one in ranges_m], "intensities": []}  # fmt: skip


def sonar_range(time_ns: int, robot: str, sonar: int, reading_m: float, limits_m: tuple[float, float],
                cone_rad: float) -> Message:
    """Return a sonar's reading as Range, in the sonar's own frame."""
    return {
        "header": header(time_ns, f"{robot}/sonar_{sonar}"), "radiation_type": _ULTRASOUND, "field_of_view": cone_rad,
        "min_range": limits_m[0], "max_range": limits_m[1], "range": reading_m,
    }  # fmt: skip


def battery(time_ns: int, frame: str, volts: float, place: str) -> Message:
    """Return a BatteryState of which only the voltage is measured."""
    return {"header": header(time_ns, frame), "voltage": volts, "present": True, "location": place,
            **dict.fromkeys(_UNMEASURED, math.nan)}  # fmt: skip


def moving_frames(time_ns: int, robot: str, at: Pose2, turret_rad: float) -> list[Message]:
    """Return the transforms from odom to base_link to turret, which is relative to the base."""
    return [transform(time_ns, f"{robot}/odom", f"{robot}/base_link", at),
            transform(time_ns, f"{robot}/base_link", f"{robot}/turret", (0.0, 0.0, turret_rad))]  # fmt: skip


def sonar_frames(time_ns: int, robot: str, mounts: Iterable[Pose2]) -> list[Message]:
    """Return the transforms from the turret to each sonar."""
    return [transform(time_ns, f"{robot}/turret", f"{robot}/sonar_{k}", at) for k, at in enumerate(mounts)]


def stamp(time_ns: int) -> Message:
    """Return a time of ROS."""
    return {"sec": time_ns // 10**9, "nanosec": time_ns % 10**9}


def header(time_ns: int, frame: str) -> Message:
    """Return a header of ROS."""
    return {"stamp": stamp(time_ns), "frame_id": frame}


def vector(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Message:
    """Return a Vector3 or Point."""
    return {"x": x, "y": y, "z": z}


def pose(x: float, y: float, angle_rad: float) -> Message:
    """Return a Pose in the plane."""
    return {"position": vector(x, y), "orientation": _rotation(angle_rad)}


def transform(time_ns: int, parent: str, child: str, at: Pose2) -> Message:
    """Return a TransformStamped in the plane."""
    moved = {"translation": vector(*at[:2]), "rotation": _rotation(at[2])}
    return {"header": header(time_ns, parent), "child_frame_id": child, "transform": moved}


def _rotation(angle_rad: float) -> Message:
    return vector() | {"z": math.sin(angle_rad / 2), "w": math.cos(angle_rad / 2)}


FieldType = tuple[Any, Any]
"""Kind and argument: (BASE, (name, length)), (NAME, type) or (ARRAY or SEQUENCE, (FieldType, length))."""
_DEFAULTS: Final[Mapping[str, Any]] = {"string": "", "bool": False, "float32": 0.0, "float64": 0.0}


class MessageBuilder:
    """Makes objects of messages.

    Parameters
    ----------
    store : type store of rosbags, with the fields of each type.
    class_of : returns the class of a type by its name, such as nav_msgs/msg/Odometry.
    array_of : returns the array for a list of numbers and the name of their type; None leaves lists.
    """

    def __init__(self, store: Typestore, class_of: Callable[[str], Callable[..., Any]],
                 array_of: Callable[[Sequence[Any], str], Any] | None = None) -> None:
        from rosbags.interfaces import Nodetype  # here: the extra ros2; the messages above need none

        self._kinds: Any = Nodetype
        self._store = store
        self._class_of = class_of
        self._array_of = array_of

    def build(self, type_name: str, message: Mapping[str, Any]) -> Any:
        """Return the object of a message; fields that it leaves out are 0 or empty, and others are ignored."""
        _, fields = self._store.fielddefs[type_name]
        return self._class_of(type_name)(**{name: self._value(kind, message.get(name)) for name, kind in fields})

    def _value(self, field: FieldType, value: Any) -> Any:
        match field:
            case self._kinds.BASE, (name, _):
                return _DEFAULTS.get(name, 0) if value is None else value
            case self._kinds.NAME, name:
                return self.build(name, value or {})
        # Arrays: of numbers as they are, since a map has a million of them.
        kind, (item, length) = field
        if value is None:
            value = [self._value(item, None)] * length if kind == self._kinds.ARRAY else []
        if item[0] == self._kinds.BASE and item[1][0] != "string":
            return value if self._array_of is None else self._array_of(value, item[1][0])
        return [self._value(item, one) for one in value]
