"""Pictures of a `Robot` and of a `RobotState` in a notebook: pose, motion, sensors, and the sonars from above."""

from __future__ import annotations

import math
from collections.abc import Iterator
from html import escape
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from nclient.state import RobotState

BODY_IN: Final = 9.0
SIZE_PX: Final = 200
NO_ECHO_IN: Final = 255
REACH_IN: Final = 130.0
"""Half the width of the picture; longer ranges are cut off."""


def state_html(state: RobotState, note: str = "") -> str:
    """Return a table of the state beside a picture of its sonars, as HTML."""
    rows = "".join(f"<tr><th style='text-align:left'>{escape(name)}</th><td style='text-align:left'>"
                   f"{escape(text)}</td></tr>" for name, text in _rows(state, note))  # fmt: skip
    return f"<div style='display:flex;gap:1em;align-items:center'>{sonars_svg(state)}<table>{rows}</table></div>"


def _rows(state: RobotState, note: str) -> Iterator[tuple[str, str]]:
    yield "model", state.model.name + note
    yield "encoders", f"x {state.x_in:.1f} in, y {state.y_in:.1f} in, heading {math.degrees(state.steering_rad):.1f}°"
    yield "moving", "yes" if state.moving else "no"
    yield "bumpers", ", ".join(map(str, state.bumpers)) or "free"
    nearest = min(state.sonars_in)
    yield "nearest sonar", f"{nearest} in" if nearest < NO_ECHO_IN else "no echo"
    if state.clock_s is not None:
        yield "clock", f"{state.clock_s:.2f} s"


def sonars_svg(state: RobotState) -> str:
    """Return the robot from above, its heading up, and a line to each sonar's range."""
    turn = state.turret_rad - state.steering_rad
    lines = []
    for number, reading in enumerate(state.sonars_in):
        angle = turn + 2.0 * math.pi * number / len(state.sonars_in)
        # Ahead is up: x of the picture is to the right of the robot.
        ahead, left = math.cos(angle), math.sin(angle)
        far = min(BODY_IN + reading, REACH_IN)
        color = "#d1495b" if reading < NO_ECHO_IN else "#ccd5dc"
        lines.append(f'<path d="M{-BODY_IN * left:.1f} {-BODY_IN * ahead:.1f}L{-far * left:.1f} {-far * ahead:.1f}" '
                     f'stroke="{color}" stroke-width="2"/>')
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{SIZE_PX}" height="{SIZE_PX}" role="img" '
        f'viewBox="{-REACH_IN:g} {-REACH_IN:g} {2 * REACH_IN:g} {2 * REACH_IN:g}"><title>sonars, heading up</title>'
        f'<rect x="{-REACH_IN:g}" y="{-REACH_IN:g}" width="{2 * REACH_IN:g}" height="{2 * REACH_IN:g}" fill="#fff"/>'
        f'{"".join(lines)}<circle r="{BODY_IN:g}" fill="#fff" stroke="#1b1b1b" stroke-width="2"/>'
        f'<path d="M0 0V{-BODY_IN:g}" stroke="#1b1b1b" stroke-width="2"/></svg>'
    )
