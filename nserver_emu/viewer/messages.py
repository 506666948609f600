"""Messages between page and daemon over the websocket: JSON objects, one per message.

to the page, by `type`
    hello        version, name (of this viewer), may_act, watch_token (of a link that may only watch; null for viewers
                 that may only watch), waypoints (points by robot), lines (addresses by name; none for watchers),
                 robot (the only one on which this page may act, null for all), names (students by robot),
                 own_methods (filters of the user, by the names that nserver --method gave them)
    programs     robots: names of the clients of each robot that has any
    picture      the scene or its changes (scene.py)
    traffic      rows of requests and replies (`TrafficMonitor`), missed: number of frames left out
    localization the latest published estimate, and its age: age_s
    map          the latest published map that is being learned, and its age: age_s
    localizers   robots: {robot: {"method", "state", "words", "has_old_map"} ...} of localizers that pages started;
                 state: starting, running, ended, failed; words: what it waits for, why it ended, or the error;
                 has_old_map: true if walls of the world have changed since the start
    asked        robots: number of clients that wait for a click of a pose (get_robot_conf), by robot
    waypoints    robot, points: new waypoints
    missed       count: other messages that were dropped since the viewer was too slow
    answer       id, ok, and the result: values, slots, or error; of drive, others: the other viewers that drive the
                 robot; of stop and release, held: {robot: {"by", "ignored"} ...} of all robots that are held

from the page, by `do`
    seen         frame: the picture that was drawn last
    watch        traffic, laser: whether it wants them; robot: the robot whose laser (left out: all)
    call         id, robot, call (C name), args (wire units): a client's call to that robot
    drive        id, robot, args: a vm that ends by itself unless the next comes within DRIVE_TIMEOUT_S
    stop         id, robot (left out: all): stop it, and refuse motions until it is released, from programs, other
                 viewers and this page (server/estop.py)
    release      id, robot (left out: all): allow motions again
    reset        id, robot (left out: all): place it where it started; a held one stays held
    control      id, command, argument: time, faults, noise, world (control/commands.py)
    adjust       id, lengths: [{ends: [[x, y], [x, y]], length, std} ...], measured with a tape; text: a world file
                 instead of the present world: the answer has the text of the world adjusted to them, and moved_in
    gallery      id: the shipped worlds, worlds: [{name, title, text of the file, walls} ...]
    click        robot, pose: x, y, steer, turret in tenths
    localize     id, robot, method, is_lost, resumes: start its localizer, in place of one that runs (localizers.py);
                 is_lost: it finds the pose itself; resumes: it begins with the estimate of the one before
    unlocalize   id, robot: end its localizer
    kidnap       id, robot, pose: as for click: place it there; its encoders stay as they are
    waypoints    robot, points: [[x_in, y_in] ...] for its localizer

A message of any other form raises InvalidMessage, which names the correct form; unknown keys are left out. A viewer
that may only watch may send seen and watch.

Estimates published by a localizer: POST /publish, one JSON object per update; the reply contains waypoints.

    robot       number of the robot                     clock_s    the robot's clock
    pose        x, y, heading of the steering           turret     its estimated direction
    cov         3 x 3 covariance of the pose            odometry, truth    poses; truth is null where unknown
    echoes      [{"sonar", "reading_in", "refusal", "innovation_in", "nis"} ...] since the previous update
    trust       OK, DEGRADED, LOST    reason    in words, "" for OK
    places      [{"pose", "share"} ...] candidate poses, the most probable first; with LOST pose and cov are undefined
    waypoints   [[x, y] ...], and the number passed     began      true: the localizer has started; waypoints
                that none before it got are for it, unless it has its own

    reply       {"waypoints": [[x, y] ...] or null, "set": how often they were set}

Maps published while they are learned (`nomad map learn --publish`): the same, with

    robot, pose, began    as above                      elapsed_s    since the beginning of the drive
    walls       [{"ends": [[x, y], [x, y]], "is_uncertain"} ...]    points    [[x, y] ...]: corners, posts
    outcome     what has become of the map, "" while it is being learned

Units are inches and radians. Anything else raises InvalidMessage.

Traffic for the page: a recorder that decodes the frames of all connections and passes them to the real recorder.

    row     {"time_s": simulated, "who": connection, "to": "robot" | "host", "what": C name or kind of reply,
             "of": C name of the request that this is or answers, "text": readable form, "hex": its bytes, "size": how
             many, "parts": of a request [["code", its number], [name, value] ...], of a reply []}

Nothing is decoded while no page watches. Decoding of a connection starts between two requests, from the wire state of
its session. At most MAX_ROWS rows are sent with a picture: further ones are counted, and decoding of the connection
starts again with the next picture.
"""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Callable
from functools import partial
from typing import Annotated, Any, Final, Literal

import msgspec
import numpy as np
from msgspec import Meta, Struct

from nclient.common.validation import InvalidValue, convert, decode_json, describe_value, reported_as
from nclient.protocol.commands import BY_NAME
from nclient.protocol.types import Model, WireState
from nclient.recording import recorder
from nclient.recording.format import format_frame
from nclient.recording.recorder import TCP, ConnectionRecorder, Decoded, FrameDecoder, TrafficRecorder
from worlds.rings import MAX_SONARS

VERSION: Final = 5
STALE_S: Final = 60.0
"""Age in real seconds from which an estimate is not shown to new pages."""
MAX_TEXT: Final = 2_000_000
"""Characters of a message from the page; a plan of faults is the longest."""
MAX_ARGS: Final = 64
MAX_POINTS: Final = 200
MAX_METHOD: Final = 1000
MAX_NUMBER: Final = 1e9
"""Largest absolute value of any number: inches, radians, seconds."""
MAX_TAPES: Final = 50
"""Measured lengths of a map."""
MAX_DEPTH: Final = 3
"""Nesting of an argument: the corners of an obstacle."""
DRIVE_TIMEOUT_S: Final = 0.5
"""Real seconds without a repeated drive message after which the robot stops."""
_COMPACT: Final = json.JSONEncoder(separators=(",", ":"))

Id = Annotated[int, Meta(ge=0, le=2**31 - 1)]
RobotOrAll = Annotated[int, Meta(ge=0, le=2**31 - 1, title="the number of a robot, or left out for every robot")]
Word = Annotated[int, Meta(ge=-(2**31), le=2**31 - 1)]
Number = Annotated[float, Meta(ge=-MAX_NUMBER, le=MAX_NUMBER)]
Point = Annotated[list[Number], Meta(min_length=2, max_length=2, title="a point [x, y]")]
Points = Annotated[list[Point], Meta(max_length=MAX_POINTS, title="a list of points [[x, y], ...] in inches")]
PoseTenths = Annotated[list[Word], Meta(min_length=4, max_length=4, title="x, y, steer and turret in whole tenths")]
Call = Literal[
    "st", "lp", "zr", "vm", "pr", "dp", "da", "conf_tm", "conf_sn", "place_robot", "add_obstacle", "delete_obstacle",
    "move_obstacle", "new_world", "refresh_all", "create_robot",
]  # fmt: skip
Control = Literal[
    "status", "pause", "resume", "speed", "step", "faults show", "faults set", "faults clear", "faults counts", "noise",
    "world show", "world set", "obstacle", "wall", "door", "walker",
]  # fmt: skip
"""Control commands of the page: all but those that write files."""
LocalizationMethod = Literal["ekf", "iekf", "ukf", "smoother", "mcl", "finder", "offsets"]
"""Filters by name: those of `nomad localize --method`. The user's own have names as well (localizers.py)."""


class _Message(Struct, tag_field="do", omit_defaults=True):
    """A message from the page."""


class _Request(_Message):
    """A message that gets an answer."""

    id: Id


class Seen(_Message, tag="seen"):
    """The picture of this frame was drawn."""

    frame: Id


class Watch(_Message, tag="watch"):
    """Choice of what the page is sent."""

    traffic: bool
    laser: bool
    robot: RobotOrAll | None = None


class CallRobot(_Request, tag="call"):
    """A client's call."""

    robot: Id
    call: Call
    args: Annotated[list[Word], Meta(max_length=MAX_ARGS, title="a list of whole numbers of 32 bits")]


class Drive(_Request, tag="drive"):
    """Velocities until the next message."""

    robot: Id
    args: Annotated[list[Word], Meta(min_length=3, max_length=3, title="three whole numbers")]


class Stop(_Request, tag="stop"):
    """Stop and hold a robot, or all."""

    robot: RobotOrAll | None = None


class Release(_Request, tag="release"):
    """End a hold."""

    robot: RobotOrAll | None = None


class Reset(_Request, tag="reset"):
    """Return a robot, or all, to the start."""

    robot: RobotOrAll | None = None


class ControlServer(_Request, tag="control"):
    """A control command."""

    command: Control
    argument: Any = None

    def __post_init__(self) -> None:
        if isinstance(self.argument, list | bool) or not _is_plain(self.argument, MAX_DEPTH):
            found = describe_value(self.argument)
            raise InvalidValue(f"expected nothing, a number, a text or an object of such, found {found}", "argument")


class Click(_Message, tag="click"):
    """A pose for a client that waits for one."""

    robot: Id
    pose: PoseTenths


class Localize(_Request, tag="localize"):
    """Start the localizer of a robot."""

    robot: Id
    method: Annotated[str, Meta(max_length=MAX_METHOD, title="the name of a filter")]
    is_lost: bool
    resumes: bool = False


class Tape(Struct):
    """A measured length between two ends of walls, and its standard deviation."""

    ends: Annotated[list[Point], Meta(min_length=2, max_length=2, title="two points")]
    length: Annotated[float, Meta(gt=0.0, le=1e5)]
    std: Annotated[float, Meta(gt=0.0, le=1e3)] = 0.1


class Adjust(_Request, tag="adjust"):
    """Adjust the walls of the world to measured lengths."""

    lengths: Annotated[list[Tape], Meta(min_length=1, max_length=MAX_TAPES, title="a list of 1 to 50 lengths")]
    text: Annotated[str, Meta(max_length=MAX_TEXT)] = ""


class Gallery(_Request, tag="gallery"):
    """Send the shipped worlds."""


class Unlocalize(_Request, tag="unlocalize"):
    """End the localizer of a robot."""

    robot: Id


class Kidnap(_Request, tag="kidnap"):
    """Place a robot without its encoders noticing."""

    robot: Id
    pose: PoseTenths


class Waypoints(_Message, tag="waypoints"):
    """Waypoints that a robot's localizer is to drive to."""

    robot: Id
    points: Points


Message = (
    Seen | Watch | CallRobot | Drive | Stop | Release | Reset | ControlServer | Click | Waypoints | Localize
    | Unlocalize | Kidnap | Gallery | Adjust
)


class InvalidMessage(ValueError):
    """A message of a wrong form; `number` is its id, if it has one."""

    def __init__(self, text: str, number: int | None = None) -> None:
        super().__init__(text)
        self.number = number


def parse_message(text: str) -> Message:
    """Parse and check a message from the page. Raises InvalidMessage."""
    if len(text) > MAX_TEXT:
        raise InvalidMessage(f"a message is at most {MAX_TEXT} characters")
    with reported_as(InvalidMessage, "a message"):
        raw = decode_json(text)
    if not isinstance(raw, dict):
        raise InvalidMessage(f"a message is a JSON object, not {describe_value(raw)}")
    # An answer to a wrong message carries its number, if that is right.
    number = raw.get("id")
    is_number = isinstance(number, int) and not isinstance(number, bool) and 0 <= number < 2**31
    with reported_as(partial(InvalidMessage, number=number if is_number else None)):
        message: Message = convert(raw, Message)
    return message


def encode_message(kind: str, **fields: Any) -> str:
    """Encode a message to the page."""
    return _COMPACT.encode({"type": kind} | fields)


def _is_plain(value: object, depth: int) -> bool:
    """Return True if a value is plain JSON with numbers in range and at most this nesting."""
    if isinstance(value, list | dict):
        items = value.values() if isinstance(value, dict) else value
        return depth > 0 and all(_is_plain(item, depth - 1) for item in items)
    return value is None or isinstance(value, str | bool) or (
        isinstance(value, int | float) and -MAX_NUMBER <= value <= MAX_NUMBER
    )  # fmt: skip


Refusal = Literal["none", "limit", "no_wall", "ambiguous_wall", "grazing", "gate"]
Trust = Literal["OK", "DEGRADED", "LOST"]
MAX_ECHOES: Final = 64
MAX_PLACES: Final = 20
MAX_WALLS: Final = 500
"""Walls of a published map."""
MAX_REASON: Final = 200
"""Characters of a reason."""
MAX_READING_IN: Final = 1000.0
"""More than any sonar measures."""
_ROUNDING: Final = 1e-6

Pose = Annotated[list[Number], Meta(min_length=3, max_length=3, title="three numbers")]


class Echo(Struct):
    """An echo since the previous update."""

    sonar: Annotated[int, Meta(ge=0, lt=MAX_SONARS)]
    reading_in: Annotated[float, Meta(ge=0.0, le=MAX_READING_IN)]
    refusal: Refusal
    innovation_in: Number
    nis: Annotated[float, Meta(ge=0.0, le=1e9)]


class Place(Struct):
    """A candidate pose and its probability."""

    pose: Pose
    share: Annotated[float, Meta(ge=0.0, le=1.0)]


class Estimate(Struct):
    """A published estimate, in inches and radians."""

    robot: Id
    clock_s: Number
    pose: Pose
    turret: Number
    cov: Annotated[list[Pose], Meta(min_length=3, max_length=3, title="three rows of three numbers")]
    odometry: Pose
    truth: Pose | None
    echoes: Annotated[list[Echo], Meta(title="a list of echoes")]
    waypoints: Annotated[list[Point], Meta(title="a list of points [[x, y], ...]")]
    trust: Trust
    reason: str
    places: Annotated[list[Place], Meta(title="a list of places")]
    passed: Id
    began: bool = False

    def __post_init__(self) -> None:
        matrix = np.array(self.cov)
        largest = float(np.abs(matrix).max())
        is_symmetric = np.abs(matrix - matrix.T).max() <= _ROUNDING * largest
        if not is_symmetric or np.linalg.eigvalsh(matrix)[0] < -_ROUNDING * largest:
            raise InvalidValue("is no covariance: not symmetric, or not positive semidefinite", "cov")
        if sum(place.share for place in self.places[:MAX_PLACES]) > 1.0 + _ROUNDING:
            raise InvalidValue("the shares sum to more than 1", "places")


class MapWall(Struct):
    """A wall of a map that is being learned."""

    ends: Annotated[list[Point], Meta(min_length=2, max_length=2, title="two points")]
    is_uncertain: bool


class GrowingMap(Struct):
    """A published map that is being learned, in inches and radians, in the frame of the world."""

    robot: Id
    elapsed_s: Number
    pose: Pose
    walls: Annotated[list[MapWall], Meta(title="a list of walls")]
    points: Annotated[list[Point], Meta(title="a list of points [[x, y], ...]")]
    outcome: str
    began: bool = False


def parse_published(text: str) -> tuple[Literal["localization", "map"], dict[str, Any]]:
    """Parse and check what was published, an estimate or a map with walls; return its kind and fields.

    Raises
    ------
    InvalidMessage
        If a field is missing or wrong.
    """
    with reported_as(InvalidMessage, "published message"):
        raw = decode_json(text)
    if not isinstance(raw, dict) or "walls" not in raw:
        return "localization", parse_estimate(text)
    with reported_as(InvalidMessage, "published map"):
        found = convert(raw, GrowingMap)
    fields: dict[str, Any] = msgspec.to_builtins(found)
    return "map", fields | {
        "walls": fields["walls"][:MAX_WALLS], "points": found.points[:MAX_POINTS],
        "outcome": found.outcome[:MAX_REASON],
    }  # fmt: skip


def parse_estimate(text: str) -> dict[str, Any]:
    """Parse and check a published estimate; long lists and reasons are truncated, and the covariance is flattened.

    Raises
    ------
    InvalidMessage
        If a field is missing or wrong.
    """
    with reported_as(InvalidMessage, "published estimate"):
        estimate = convert(decode_json(text), Estimate)
    fields: dict[str, Any] = msgspec.to_builtins(estimate)
    return fields | {
        "cov": [number for row in estimate.cov for number in row],
        "echoes": fields["echoes"][:MAX_ECHOES], "waypoints": estimate.waypoints[:MAX_POINTS],
        "places": fields["places"][:MAX_PLACES], "reason": estimate.reason[:MAX_REASON],
    }  # fmt: skip


MAX_ROWS: Final = 40
MAX_PENDING: Final = 64
"""Requests of a connection that wait for their reply."""
HANDSHAKE: Final = "hello"
"""The unrequested reply with which a robot's own line begins."""
MAX_HEX: Final = 512
"""Bytes of a row that are shown."""
WireStateOf = Callable[[str], WireState | None]
"""Maps the name of a connection to its wire state; None within a request, or for an unknown connection."""
Row = dict[str, Any]


class TrafficMonitor:
    """Recorder that makes rows for the page.

    Parameters
    ----------
    inner : the recorder to which everything is passed on.
    wire_state_of : wire states of connections by name.
    time_s : returns simulated time.
    """

    def __init__(self, inner: TrafficRecorder, wire_state_of: WireStateOf, time_s: Callable[[], float]) -> None:
        self.inner = inner
        self.record_step, self.record_pace = inner.record_step, inner.record_pace
        self.record_change, self.close = inner.record_change, inner.close
        self.watched = False
        """True while a page watches."""
        self.missed = 0
        """Frames that were not decoded since the last rows."""
        self.wire_state_of = wire_state_of
        self._time_s = time_s
        self._rows: list[Row] = []

    def rows(self) -> list[Row]:
        """Return the rows since the last call."""
        rows, self._rows = self._rows, []
        return rows

    def open(self, name: str, line: str, model: Model, robot_id: int | None = None) -> ConnectionRecorder:
        """Return the recorder of a connection."""
        return _ConnectionTraffic(self, name, line, model, self.inner.open(name, line, model, robot_id))

    @property
    def is_full(self) -> bool:
        """True if no more rows are made until the present ones have been fetched."""
        return len(self._rows) >= MAX_ROWS

    def add(self, name: str, to: str, data: bytes, frames: list[Decoded], pending: deque[str], line: str) -> None:
        """Add the rows of decoded frames; `pending` has the connection's requests that wait for a reply."""
        for frame in frames:
            self._rows.append({
                "time_s": round(self._time_s(), 3), "who": name, "to": to,
                "what": frame.get("call") or frame.get("reply") or "error", "of": _command_of(frame, pending),
                "text": format_frame(frame),
                "hex": data[:MAX_HEX].hex(" "), "size": len(data), "parts": parts(frame, line),
            })  # fmt: skip


def _command_of(frame: Decoded, pending: deque[str]) -> str:
    """Return the command that a frame is or answers; replies come in the order of the requests."""
    name: str = frame.get("call", "")
    if name and BY_NAME[name].has_tcp_reply:
        pending.append(name)
    return name or (pending.popleft() if "reply" in frame and frame["reply"] != HANDSHAKE and pending else "")


def parts(frame: Decoded, line: str) -> list[list[Any]]:
    """Return a request's code and its arguments by name; arguments of variable number are numbered from 1."""
    if "call" not in frame:
        return []
    row = BY_NAME[frame["call"]]
    names = [argument.name for argument in row.arguments]
    extra: list[list[Any]] = []
    if row.extra_arguments is not None:
        name, position = row.extra_arguments
        del names[position]
        extra = [[name, frame[name]]] if name in frame else []
    args = frame["args"]
    names = names[: len(args)] + [str(k + 1) for k in range(len(args) - len(names))]
    code = row.tcp_type if line == TCP else row.line_type
    return [["code", code], *extra, *map(list, zip(names, args, strict=True))]


class _ConnectionTraffic:
    """Recorder of one connection."""

    def __init__(self, traffic: TrafficMonitor, name: str, line: str, model: Model, inner: ConnectionRecorder) -> None:
        self._traffic, self._inner = traffic, inner
        self._name, self._line, self._model = name, line, model
        self._decoder: FrameDecoder | None = FrameDecoder(line, model)
        self._pending: deque[str] = deque(maxlen=MAX_PENDING)

    def to_robot(self, data: bytes) -> None:
        """Record a request."""
        self._inner.to_robot(data)
        if self._is_watched():
            if self._decoder is None:
                self._start_decoding()
            if self._decoder is not None:
                self._traffic.add(self._name, "robot", data, self._decoder.to_robot(data), self._pending, self._line)

    def to_host(self, data: bytes, by_time: bool = False) -> None:
        """Record a reply."""
        self._inner.to_host(data, by_time)
        if self._is_watched() and self._decoder is not None:
            self._traffic.add(self._name, "host", data, self._decoder.to_host(data), self._pending, self._line)

    def close(self) -> None:
        """Close the inner recorder."""
        self._inner.close()

    def _is_watched(self) -> bool:
        if self._traffic.watched and not self._traffic.is_full:
            return True
        self._traffic.missed += self._traffic.watched
        self._decoder = None
        self._pending.clear()
        return False

    def _start_decoding(self) -> None:
        wire_state = self._traffic.wire_state_of(self._name)
        if wire_state is None:
            return
        line = recorder.SERIAL if self._line == recorder.HANDSHAKE_FIRST else self._line
        self._decoder = FrameDecoder(line, self._model)
        self._decoder.resume(wire_state)
