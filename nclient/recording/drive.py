"""Drives: pose by odometry and sonars over time, in metres, radians and seconds, whatever file they come from.

    recording, bag, MCAP, CARMEN log, CSV ──read──> Drive ──write──> any of them          (nclient/recording/convert.py)

A Drive that was read from a recording of this project keeps its lines (`traffic`): formats that can carry text carry
them, so that the way back gives the same recording. What is lost on the way is named in `omitted`.

Also here: a drive as a robot. `DrivePeer` answers a program's requests with the samples, one after another, so that
`replay:` takes files of other programs.
"""

import json
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any, Final, NamedTuple

from nclient.errors import RecordingError, WireError, version
from nclient.protocol import codec, types
from nclient.protocol.codec import TcpFrame, TcpFramer, request_bounds
from nclient.protocol.commands import BY_NAME, Call
from nclient.protocol.decode import TO_HOST, TO_ROBOT, WireDecoder
from nclient.protocol.replies import Reply
from nclient.protocol.types import M_PER_IN, Model, heading_tenths, tcp_wire_state, tenths, tenths_from_rad, wrap_word
from nclient.recording.format import FORMAT, IN, OUT, VERSION, Entry, Recording, as_object

RING: Final = tuple(math.tau * k / types.SONAR_SLOTS for k in range(types.SONAR_SLOTS))
"""Directions of a Nomad's sonars from ahead, counter-clockwise."""
_TENTH_M: Final = M_PER_IN / 10
# Places in the State vector (docs/protocol.md).
_SONARS, _BUMPER, _POSE, _SPEEDS = 17, 33, slice(34, 38), slice(38, 41)
_MEASURED: Final = ("state", "sonar", "configuration")
"""Replies that make a sample: those with a pose or with sonars."""


class Sample(NamedTuple):
    """Measurements of a robot at one instant.

    Attributes
    ----------
    time_s
        Seconds since the start of the drive.
    x_m, y_m, heading_rad
        Pose by odometry.
    turret_rad
        Direction of the ring of sonars, in the frame of the odometry; None: that of the robot.
    speed_m_s, turn_rad_s
        Velocity along the heading, and of the heading.
    ranges_m
        The last reading of each sonar, inf for no echo; empty if there was none.
    bumpers
        Bits of State[33].
    volts
        Of the computer's battery and the motors'.
    """

    time_s: float
    x_m: float = 0.0
    y_m: float = 0.0
    heading_rad: float = 0.0
    turret_rad: float | None = None
    speed_m_s: float = 0.0
    turn_rad_s: float = 0.0
    ranges_m: tuple[float, ...] = ()
    bumpers: int = 0
    volts: tuple[float, float] | None = None


@dataclass(slots=True)
class Drive:
    """The samples of one robot in the order of time.

    Attributes
    ----------
    samples
        At least one.
    directions_rad
        Direction of each sonar from ahead of the turret, counter-clockwise.
    ring_m
        Distance of the sonars from the axis of the turret; 0 if unknown. Ranges begin there.
    start_s
        Unix time of the start; 0 if unknown.
    model
        Model of the robot.
    traffic
        Lines of the recording, its header first; empty if the drive comes from elsewhere.
    omitted
        What of the source is not in the drive, in words.
    """

    samples: list[Sample]
    directions_rad: tuple[float, ...] = RING
    ring_m: float = 0.0
    start_s: float = 0.0
    model: Model = types.N150
    traffic: list[str] = field(default_factory=list)
    omitted: list[str] = field(default_factory=list)


# -- recordings of this project ---------------------------------------------------------------------------------------


def drive_of_recording(recording: Recording, lines: Sequence[str]) -> Drive:
    """Return the drive in a recording: the robot of its first connection.

    Parameters
    ----------
    recording
        A recording that was read.
    lines
        The lines of its file.

    Raises
    ------
    RecordingError
        If no reply in it has a pose.
    """
    # 1. Replies of the first connection that has any.
    names = recording.connections()
    drive = Drive([], traffic=list(lines), start_s=_start(recording))
    if recording.cut:
        # With a line end behind it the rest of a line would be an error.
        drive.traffic.pop()
        drive.omitted.append(recording.cut)
    for name in names:
        entries = [entry for entry in recording.entries if entry.connection == name]
        opened = dict(recording.header) | dict(next((entry.more for entry in entries if entry.kind == "open"), {}))
        drive.model = types.MODELS.get(str(opened.get("model", "")).lower(), types.N150)
        drive.samples = list(_samples(entries, drive.model, str(opened.get("wire", "tcp"))))
        if drive.samples:
            others = [other for other in names if other != name]
            drive.ring_m = ring_of(drive)
            if others:
                drive.omitted.append(f"samples of the connections {', '.join(others)} (only {name} is decoded)")
            return drive
    raise RecordingError(f"{recording.name}: no reply in it has a pose; record a run in which the robot is asked for "
                         "its state")


def _start(recording: Recording) -> float:
    try:
        return datetime.fromisoformat(str(recording.header.get("started", ""))).timestamp()
    except ValueError:
        return 0.0


def _samples(entries: Sequence[Entry], model: Model, wire: str) -> Iterator[Sample]:
    decoder = WireDecoder("tcp" if wire == "tcp" else "serial", model)
    before: Sample | None = None
    for entry in entries:
        for frame in entry.decoded or _decode(entry, decoder):
            if frame.get("reply") in _MEASURED:
                sample = _sample(frame, entry.time_s, model)
                # Two replies of one instant are one sample; times of a drive increase.
                if sample is not None and (before is None or sample.time_s > before.time_s):
                    yield sample
                    before = sample


def _decode(entry: Entry, decoder: WireDecoder) -> list[dict[str, Any]]:
    if entry.kind not in (IN, OUT) or not entry.data:
        return []
    return [decoder.read(f"{TO_ROBOT if entry.kind == OUT else TO_HOST} {entry.data.hex()}")]


def _sample(frame: Any, time_s: float, model: Model) -> Sample | None:
    slots = frame["State"]
    if None in slots[_POSE]:
        return None
    # Values of 64-bit clients have no sign; those that no reply has set yet count as 0.
    state = [wrap_word(value or 0) for value in slots]
    x, y, steer, turret = state[_POSE]
    right, left, _ = state[_SPEEDS]
    speed, turn = float(right), float(left)
    if model is types.SCOUT:
        # Velocities of the wheels: half of their sum drives, half of their difference turns.
        speed, turn = (right + left) / 2, (right - left) / 2 / types.SCOUT_WHEEL_IN_PER_DEG
    sonars = state[_SONARS : _SONARS + types.SONAR_SLOTS]
    has_sonars = None not in slots[_SONARS : _SONARS + types.SONAR_SLOTS]
    cpu, motors = frame.get("volt_cpu"), frame.get("volt_motor")
    return Sample(
        time_s, x * _TENTH_M, y * _TENTH_M, _rad(steer), _rad(turret), speed * _TENTH_M, _rad(turn),
        tuple(math.inf if value >= types.MAX_SONAR_IN else value * M_PER_IN for value in sonars) if has_sonars else (),
        state[_BUMPER], None if cpu is None or motors is None else (cpu, motors),
    )


def _rad(value_tenths: float) -> float:
    return math.radians(value_tenths / 10)


def ring_of(drive: Drive) -> float:
    """Return the distance of the sonars from the axis in metres, if they are a Nomad's; else 0."""
    return types.SONAR_RING_IN[drive.model.name] * M_PER_IN if drive.directions_rad == RING else 0.0


def recording_of_drive(drive: Drive) -> list[str]:
    """Return the lines of a recording: those that the drive was read from, else one made of its samples.

    A recording made of samples has a CONNECT and one request for the state per sample; `replay:` with `order=loose`
    answers from it. Readings are rounded to the wire's units, and given to the sonar nearest to their direction.
    """
    if drive.traffic:
        return drive.traffic
    model = drive.model
    header = {"format": FORMAT, "version": VERSION, "package": version(), "wire": "tcp", "model": model.name}
    if drive.start_s:
        header["started"] = datetime.fromtimestamp(drive.start_s).astimezone().isoformat()
    decoder, state = WireDecoder("tcp", model), tcp_wire_state(model)

    def entries(time_s: float, call: Call, reply: Reply) -> Iterator[str]:
        row = BY_NAME[call.name]
        request, answer = codec.encode_tcp_request(call), codec.encode_tcp_reply(row, reply, state)
        yield json.dumps(as_object(Entry(time_s, OUT, "", request, (decoder.request(request),))), separators=(",", ":"))
        yield json.dumps(as_object(Entry(time_s, IN, "", answer, (decoder.reply(answer),))), separators=(",", ":"))

    first = drive.samples[0]
    lines = [json.dumps(header, separators=(",", ":"))]
    lines += entries(first.time_s, Call("connect_robot", (1, 1)), Reply("simple", values=(7019,)))
    for sample in drive.samples:
        lines += entries(sample.time_s, Call("gs"), state_reply(drive, sample))
    return lines


def state_reply(drive: Drive, sample: Sample) -> Reply:
    """Return a sample as the reply that a robot would have sent."""
    turret = sample.heading_rad if sample.turret_rad is None else sample.turret_rad
    speeds = (tenths(sample.speed_m_s / M_PER_IN), tenths_from_rad(sample.turn_rad_s), 0)
    if drive.model is types.SCOUT:
        # Wheels: the sum drives, the difference turns.
        turn = math.degrees(sample.turn_rad_s) * types.SCOUT_WHEEL_IN_PER_DEG
        speeds = (tenths(sample.speed_m_s / M_PER_IN + turn), tenths(sample.speed_m_s / M_PER_IN - turn), 0)
    slots = {
        0: 10,
        **{_SONARS + k: _sonar_in(range_m) for k, range_m in enumerate(nomad_ring(drive, sample))},
        _BUMPER: sample.bumpers,
        34: tenths(sample.x_m / M_PER_IN), 35: tenths(sample.y_m / M_PER_IN),
        36: heading_tenths(sample.heading_rad), 37: heading_tenths(turret),
        38: speeds[0], 39: speeds[1], 40: speeds[2],
        41: 1 if sample.speed_m_s else 0,
    }
    clock = round(sample.time_s * 1000) % 2**32
    return Reply("state", slots, (0,), clock=clock, volts=(0, 0))


def _sonar_in(range_m: float) -> int:
    return types.MAX_SONAR_IN if not range_m < types.MAX_SONAR_IN * M_PER_IN else max(0, round(range_m / M_PER_IN))


def nomad_ring(drive: Drive, sample: Sample) -> tuple[float, ...]:
    """Return the reading nearest in direction to each of a Nomad's sixteen sonars; inf where none is near."""
    if not sample.ranges_m:
        return (math.inf,) * types.SONAR_SLOTS
    if drive.directions_rad == RING:
        return sample.ranges_m
    half_step = math.pi / types.SONAR_SLOTS
    found = []
    for wanted in RING:
        apart, k = min((abs(math.remainder(angle - wanted, math.tau)), k)
                       for k, angle in enumerate(drive.directions_rad))
        found.append(sample.ranges_m[k] if apart <= half_step else math.inf)
    return tuple(found)


# -- a drive as a robot -----------------------------------------------------------------------------------------------


class DrivePeer:
    """The other end of a MemoryStream that answers like a Nserver, each state with the next sample of a drive.

    Motion commands change nothing: the robot drives as it once did. dp and da move the frame of the odometry, as on a
    robot. Past the last sample a request raises RecordingError.
    """

    def __init__(self, name: str, drive: Drive) -> None:
        self._name = name
        self._drive = drive
        self._framer = TcpFramer(request_bounds)
        self._state = tcp_wire_state(drive.model)
        self._out = bytearray()
        self._next = 0
        self._move: Callable[[Sample], Sample] = lambda sample: sample

    def send(self, data: bytes) -> None:
        """Process requests. Raises RecordingError at the end of the drive."""
        for frame in self._framer.receive(data):
            if isinstance(frame, TcpFrame):
                self._answer(codec.decode_tcp_request(frame))

    def receive(self) -> bytes:
        """Return and remove the replies so far."""
        data = bytes(self._out)
        self._out.clear()
        return data

    def close(self) -> None:
        """Do nothing: a file has no connection to close."""

    def _answer(self, call: Call) -> None:
        self._state.wide = bool(self._framer.wide)
        codec.update_from_request(call, self._state)
        row = BY_NAME[call.name]
        if not row.has_tcp_reply:
            return
        match row.tcp_reply.kind:
            case "state" | "sonar" | "bumper" | "configuration" | "velocity":
                reply = self._measure(call)._replace(kind=row.tcp_reply.kind)
            case "simple":
                reply = Reply("simple", values=(7019 if call.name.endswith("connect_robot") else 0,))
            case _:
                # Not available on this robot.
                reply = Reply("error", values=(4,))
        try:
            self._out += codec.encode_tcp_reply(row, reply, self._state)
        except WireError:
            self._out += codec.encode_tcp_reply(row, Reply("error", values=(4,)), self._state)

    def _measure(self, call: Call) -> Reply:
        # Only questions take the next sample: settings and motion commands are answered with the last one.
        samples = self._drive.samples
        is_question = call.name in ("gs", "ws") or call.name.startswith("get_")
        if is_question and self._next >= len(samples):
            raise RecordingError(f"{self._name}: the recorded drive ends here, after "
                                 f"{samples[-1].time_s - samples[0].time_s:.1f} s")
        self._next += is_question
        sample = samples[max(0, min(self._next, len(samples)) - 1)]
        if call.name in ("dp", "da"):
            self._move = _moved(self._move(sample), sample, call)
        return state_reply(self._drive, self._move(sample))


def _moved(shown: Sample, sample: Sample, call: Call) -> Callable[[Sample], Sample]:
    """Return the change of frame that shows `sample` at the position or angles that a dp or da sets."""
    x, y, heading, turret = shown.x_m, shown.y_m, shown.heading_rad, shown.turret_rad
    if call.name == "dp":
        x, y = call.args[0] * _TENTH_M, call.args[1] * _TENTH_M
    else:
        heading, turret = _rad(call.args[0]), _rad(call.args[1])
    turn = heading - sample.heading_rad
    turn_ring = turn if turret is None or sample.turret_rad is None else turret - sample.turret_rad
    cos, sin = math.cos(turn), math.sin(turn)

    def move(one: Sample) -> Sample:
        dx, dy = one.x_m - sample.x_m, one.y_m - sample.y_m
        ring = None if one.turret_rad is None else one.turret_rad + turn_ring
        return one._replace(x_m=x + cos * dx - sin * dy, y_m=y + sin * dx + cos * dy,
                            heading_rad=one.heading_rad + turn, turret_rad=ring)

    return move


