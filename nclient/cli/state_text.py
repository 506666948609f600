"""Formatting of robot states and replies as text with units.

    x 24.0 in  y 0.0 in  steering 0.0 deg  turret 0.0 deg | standing | nearest 35 in at 0 deg | clock 12.3 s

Values that the robot has not reported are omitted or shown as unknown. PARTS lists the parts of a state; replies that
are not stored in the state are formatted by VALUES, or as plain numbers.
"""

from collections.abc import Callable, Iterable, Iterator
from typing import Any

from nclient.errors import ShellError, suggest
from nclient.protocol.commands import Call
from nclient.protocol.replies import Reply, text_of
from nclient.protocol.types import unwrap_word
from nclient.state import NO_ECHO_IN, RobotState

# Angle between adjacent sonars of the ring: 360 / 16 degrees.
_SECTOR_DEG = 22.5
# Columns of the name of a part.
_WIDTH = 11
_POSE = "x {:.1f} in  y {:.1f} in  steering {:.1f} deg  turret {:.1f} deg"


def format_state(state: RobotState) -> str:
    """Return the state in one line: pose, motion, nearest echo, bumpers, clock."""
    parts = [_pose(state), format_motion(state)]
    # 0 means no reading yet, NO_ECHO_IN no echo.
    nearest = min(range(16), key=lambda number: state.sonars_in[number])
    if 0 < state.sonars_in[nearest] < NO_ECHO_IN:
        parts.append(f"nearest {state.sonars_in[nearest]} in at {_SECTOR_DEG * nearest:g} deg")
    if state.is_held:
        parts.append("HELD")
    if state.touching:
        parts.append(f"BUMPER {' '.join(map(str, state.bumpers))}")
    if state.clock_s is not None:
        parts.append(f"clock {state.clock_s:.1f} s")
    return " | ".join(parts)


def format_motion(state: RobotState) -> str:
    """Return the moving axes with their speeds."""
    axes = {
        "translation": (state.translation_moving, f"{state.translation_in_s:.1f} in/s"),
        "steering": (state.steering_moving, f"{state.steering_deg_s:.1f} deg/s"),
        "turret": (state.turret_moving, f"{state.turret_deg_s:.1f} deg/s"),
    }
    values = ", ".join(f"{axis} {speed}" for axis, (moves, speed) in axes.items() if moves)
    return f"moving: {values}" if values else "standing"


def format_parts(state: RobotState, parts: Iterable[str] = ()) -> Iterator[str]:
    """Yield one line per part of the state; without `parts` all of them."""
    for part in tuple(parts) or tuple(PARTS):
        yield f"{part:{_WIDTH}} {PARTS[part](state)}"


def check_parts(parts: Iterable[str]) -> None:
    """Raise ShellError for a name that is not in PARTS."""
    for part in parts:
        if part not in PARTS:
            raise ShellError(f"no part {part!r} of the state; there are {', '.join(PARTS)}{suggest(part, PARTS)}")


def as_json(state: RobotState) -> dict[str, Any]:
    """Return the state as a JSON object: plain numbers with the unit in each key, null if unknown."""
    battery = state.battery
    return {
        "model": state.model.name, "clock_s": state.clock_s,
        "x_in": state.x_in, "y_in": state.y_in, "steering_deg": state.steering_deg, "turret_deg": state.turret_deg,
        "translation_in_s": state.translation_in_s, "steering_deg_s": state.steering_deg_s,
        "turret_deg_s": state.turret_deg_s, "moving": state.moving,
        # Without echo there is no range, so null rather than a large number.
        "sonars_in": [None if reading >= NO_ECHO_IN else reading for reading in state.sonars_in],
        "infrareds": list(state.infrareds) if state.model.has_infrared else None,
        "bumpers": list(state.bumpers), "compass_deg": state.compass_deg,
        "cpu_v": None if battery is None else round(battery.cpu_v, 3),
        "motor_v": None if battery is None else round(battery.motor_v, 3), "error": state.error,
        "held": state.is_held,
    }  # fmt: skip


def _pose(state: RobotState) -> str:
    return _POSE.format(state.x_in, state.y_in, state.steering_deg, state.turret_deg)


def _velocity(state: RobotState) -> str:
    # A Scout has no turret; its third velocity has no meaning, its wheels have.
    wheels = "" if state.model.has_turret else f"  right {state.right_in_s:.1f} in/s  left {state.left_in_s:.1f} in/s"
    return (f"translation {state.translation_in_s:.1f} in/s  steering {state.steering_deg_s:.1f} deg/s  turret "
            f"{state.turret_deg_s:.1f} deg/s{wheels}")


def _motors(state: RobotState) -> str:
    scout = {"on mains": state.on_mains, "charging": state.charging, "EMERGENCY STOP": state.emergency_stop}
    return ", ".join((format_motion(state), *(word for word, is_set in scout.items() if is_set)))


def _sonar(state: RobotState) -> str:
    readings = " ".join("  -" if reading >= NO_ECHO_IN else f"{reading:3}" for reading in state.sonars_in)
    return f"{readings}  in, counter-clockwise from ahead; - no echo"


def _infrared(state: RobotState) -> str:
    if not state.model.has_infrared:
        return "none on this model"
    return f"{' '.join(f'{reading:3}' for reading in state.infrareds)}  0 near, 15 nothing"


def _laser(state: RobotState) -> str:
    # Without points the vector may still have pixel rows of the camera: shown raw, the first eight.
    points, rows = state.laser_points_in, state.laser[1:]
    if not points and rows:
        return f"{len(rows)} rows of the camera: {' '.join(map(str, rows[:8]))}{' ..' if len(rows) > 8 else ''}"
    if not points:
        return "no readings" if state.model.has_laser else "none on this model"
    shown = "  ".join(f"({', '.join(f'{value:.1f}' for value in point)})" for point in points[:4])
    return f"{len(points)} readings, in: {shown}{' ..' if len(points) > 4 else ''}"


def _battery(state: RobotState) -> str:
    battery = state.battery
    return "unknown" if battery is None else f"computer {battery.cpu_v:.1f} V  motors {battery.motor_v:.1f} V"


PARTS: dict[str, Callable[[RobotState], str]] = {
    "pose": _pose,
    "velocity": _velocity,
    "motors": _motors,
    "sonar": _sonar,
    "infrared": _infrared,
    "bumpers": lambda state: f"TOUCHING: {' '.join(map(str, state.bumpers))}" if state.touching else "free",
    "compass": lambda state: f"{state.compass_deg:.1f} deg",
    "laser": _laser,
    "battery": _battery,
    "clock": lambda state: "unknown" if state.clock_s is None else f"{state.clock_s:.3f} s",
    "error": lambda state: str(state.error) if state.error else "none",
    "hold": lambda state: "HELD by a person (Stop): release it on the page or with nserver ctl release"
    if state.is_held else "none",
}
"""Parts of the state, and the function that formats each."""


SHOWN = {"bumper": "bumpers"} | {kind: kind for kind in ("infrared", "sonar", "compass", "laser", "velocity")}
"""Part of the state that is shown for a kind of reply."""


def format_reply(call: Call, reply: Reply, state: RobotState) -> Iterator[str]:
    """Yield the lines that show the result of a call; `state` is the state after it."""
    if call.name == "get_ra":
        yield _accelerations(reply)
    elif reply.kind == "state":
        yield format_state(state)
    elif reply.kind == "configuration":
        yield _clicked(reply) if reply.values else next(format_parts(state, ("pose",)))
    elif reply.kind in SHOWN and not reply.values:
        yield from format_parts(state, (SHOWN[reply.kind],))
    elif call.name in VALUES:
        yield from VALUES[call.name](reply)
    else:
        yield _plain(reply)


def _plain(reply: Reply) -> str:
    if reply.kind == "nak":
        return "refused by the robot (NAK)"
    return " ".join(map(str, reply.values)) if len(reply.values) > 1 else "ok"


def _accelerations(reply: Reply) -> str:
    # State[38] to State[40], tenths of in/s2 and deg/s2.
    values = [reply.slots.get(slot, 0) / 10 for slot in (38, 39, 40)]
    return "translation {:.1f} in/s2  steering {:.1f} deg/s2  turret {:.1f} deg/s2".format(*values)


def _clicked(reply: Reply) -> str:
    return _POSE.format(*[value / 10 for value in reply.values])


def _truth(reply: Reply) -> Iterator[str]:
    # The first number is always 1. Lengths are 1/1000 in, angles 1/1000 deg, the time an unsigned word
    # in ms.
    _, time_ms, x, y, heading, turret, seed, robot = reply.values
    yield (f"ground truth x {x / 1000:.3f} in  y {y / 1000:.3f} in  heading {heading / 1000:.3f} deg  turret "
           f"{turret / 1000:.3f} deg | {unwrap_word(time_ms) / 1000:.3f} s | robot {robot}, seed {seed}")


def _hold(reply: Reply) -> Iterator[str]:
    by = text_of(reply.values)
    yield f"held by {by}: release it on the page or with nserver ctl release" if by else "not held"


def _time(reply: Reply) -> Iterator[str]:
    # The speed is ten times the factor; 0 means no relation to real time.
    _, time_ms, speed, paused = reply.values
    pace = "paused" if paused else f"{speed / 10:g} x real time" if speed else "as clients ask, or as fast as it can"
    yield f"simulated time {time_ms / 1000:.3f} s, {pace}"


def _collision(reply: Reply) -> Iterator[str]:
    # Thousandths of an inch; the normal in microradians.
    hit, x, y, normal = reply.values
    yield f"hits at x {x / 1000:.1f} in  y {y / 1000:.1f} in, normal {normal / 1e6:.3f} rad" if hit else "free"


def _robots(reply: Reply) -> Iterator[str]:
    # Three numbers per robot: x and y in 1/10 in, heading in 1/10 deg.
    count, *numbers = reply.values
    for number in range(count):
        x, y, heading = numbers[3 * number : 3 * number + 3]
        yield f"robot {number + 1}: x {x / 10:.1f} in  y {y / 10:.1f} in  heading {heading / 10:.1f} deg"


def _prediction(reply: Reply) -> Iterator[str]:
    # The reply is a predicted State vector: infrareds in State[1] to [16], sonars in State[17] to [32].
    yield f"infrared    {' '.join(f'{reading:3}' for reading in reply.values[1:17])}"
    sonars = ("  -" if reading >= NO_ECHO_IN else f"{reading:3}" for reading in reply.values[17:33])
    yield f"sonar       {' '.join(sonars)}  in"


VALUES: dict[str, Callable[[Reply], Iterator[str]]] = {
    "sim_truth": _truth, "sim_control": _time, "motion_check": _collision, "get_rpx": _robots,
    "held_by": _hold, "predict_sensors": _prediction,
}  # fmt: skip
"""Formatting of replies that are not stored in the state, by command."""
