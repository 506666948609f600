"""A robot's state in words, with units: in one line, or part by part.

    x 24.0 in  y 0.0 in  steering 0.0 deg  turret 0.0 deg | standing | nearest 35 in at 0 deg | clock 12.3 s

Rules: pure; what was never told is left out or said to be unknown, never made up. A part is a row of PARTS.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Any

from nclient.errors import ShellError
from nclient.robot_state import NOTHING_IN, RobotState
from nclient.suggesting import did_you_mean

_SECTOR_DEG = 22.5
_WIDTH = 11


def line(state: RobotState) -> str:
    """What matters while one drives, in one line."""
    parts = [_pose(state), moving(state)]
    nearest = min(range(16), key=lambda number: state.sonars_in[number])
    if 0 < state.sonars_in[nearest] < NOTHING_IN:
        parts.append(f"nearest {state.sonars_in[nearest]} in at {_SECTOR_DEG * nearest:g} deg")
    if state.touching:
        parts.append(f"BUMPER {' '.join(map(str, state.bumpers))}")
    if state.clock_s is not None:
        parts.append(f"clock {state.clock_s:.1f} s")
    return " | ".join(parts)


def moving(state: RobotState) -> str:
    """Which axes move, and how fast it goes."""
    axes = {
        "translation": (state.translation_moving, f"{state.translation_in_s:.1f} in/s"),
        "steering": (state.steering_moving, f"{state.steering_deg_s:.1f} deg/s"),
        "turret": (state.turret_moving, f"{state.turret_deg_s:.1f} deg/s"),
    }
    told = ", ".join(f"{axis} {speed}" for axis, (moves, speed) in axes.items() if moves)
    return f"moving: {told}" if told else "standing"


def lines(state: RobotState, parts: Iterable[str] = ()) -> Iterator[str]:
    """The parts, all where none is named; each is one of PARTS."""
    for part in tuple(parts) or tuple(PARTS):
        yield f"{part:{_WIDTH}} {PARTS[part](state)}"


def check(parts: Iterable[str]) -> None:
    """Raises ShellError for a part that there is not."""
    for part in parts:
        if part not in PARTS:
            raise ShellError(f"no part {part!r} of the state; there are {', '.join(PARTS)}{did_you_mean(part, PARTS)}")


def as_object(state: RobotState) -> dict[str, Any]:
    """The same for programs: plain numbers, the unit in each name; null where nothing was told."""
    battery = state.battery
    return {
        "model": state.model.name, "clock_s": state.clock_s,
        "x_in": state.x_in, "y_in": state.y_in, "steering_deg": state.steering_deg, "turret_deg": state.turret_deg,
        "translation_in_s": state.translation_in_s, "steering_deg_s": state.steering_deg_s,
        "turret_deg_s": state.turret_deg_s, "moving": state.moving,
        "sonars_in": [None if reading >= NOTHING_IN else reading for reading in state.sonars_in],
        "infrareds": list(state.infrareds) if state.model.has_infrared else None,
        "bumpers": list(state.bumpers), "compass_deg": state.compass_deg,
        "cpu_v": None if battery is None else round(battery.cpu_v, 3),
        "motor_v": None if battery is None else round(battery.motor_v, 3), "error": state.error,
    }  # fmt: skip


def _pose(state: RobotState) -> str:
    return (
        f"x {state.x_in:.1f} in  y {state.y_in:.1f} in  "
        f"steering {state.steering_deg:.1f} deg  turret {state.turret_deg:.1f} deg"
    )


def _velocity(state: RobotState) -> str:
    wheels = "" if state.model.has_turret else f"  right {state.right_in_s:.1f} in/s  left {state.left_in_s:.1f} in/s"
    return (
        f"translation {state.translation_in_s:.1f} in/s  steering {state.steering_deg_s:.1f} deg/s  "
        f"turret {state.turret_deg_s:.1f} deg/s{wheels}"
    )


def _motors(state: RobotState) -> str:
    scout = {"on mains": state.on_mains, "charging": state.charging, "EMERGENCY STOP": state.emergency_stop}
    return ", ".join((moving(state), *(word for word, said in scout.items() if said)))


def _sonar(state: RobotState) -> str:
    readings = " ".join("  -" if reading >= NOTHING_IN else f"{reading:3}" for reading in state.sonars_in)
    return f"{readings}  in, counter-clockwise from ahead; - heard nothing"


def _infrared(state: RobotState) -> str:
    if not state.model.has_infrared:
        return "none on this model"
    return f"{' '.join(f'{reading:3}' for reading in state.infrareds)}  0 near, 15 nothing"


def _bumpers(state: RobotState) -> str:
    return f"TOUCHING: {' '.join(map(str, state.bumpers))}" if state.touching else "free"


def _laser(state: RobotState) -> str:
    points, rows = state.laser_points_in, state.laser[1:]
    if not points and rows:
        return f"{len(rows)} rows of the camera: {' '.join(map(str, rows[:8]))}{' ..' if len(rows) > 8 else ''}"
    if not points:
        return "no readings" if state.model.has_laser else "none on this model"
    shown = "  ".join(f"({', '.join(f'{value:.1f}' for value in point)})" for point in points[:4])
    return f"{len(points)} readings, in: {shown}{' ..' if len(points) > 4 else ''}"


def _battery(state: RobotState) -> str:
    battery = state.battery
    return "not told" if battery is None else f"computer {battery.cpu_v:.1f} V  motors {battery.motor_v:.1f} V"


def _clock(state: RobotState) -> str:
    return "not told" if state.clock_s is None else f"{state.clock_s:.3f} s"


PARTS: dict[str, Callable[[RobotState], str]] = {
    "pose": _pose,
    "velocity": _velocity,
    "motors": _motors,
    "sonar": _sonar,
    "infrared": _infrared,
    "bumpers": _bumpers,
    "compass": lambda state: f"{state.compass_deg:.1f} deg",
    "laser": _laser,
    "battery": _battery,
    "clock": _clock,
    "error": lambda state: str(state.error) if state.error else "none",
}
"""A part, and how it is told."""
