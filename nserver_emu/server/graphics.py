"""What clients have drawn into the window, and which layers they asked to be redrawn. Pure; whoever shows it reads it.

    layer       actual_trace | encoder_trace | bumper | infrared | sonar | laser | client_graphics
    shape       line x1 y1 x2 y2 | arc x0 y0 w h th1 th2 | robot x y steer turret | arrow x y steer turret
    mode        line, arc   1 black   2 black XOR              above 2 colour(mode - 2) XOR
                robot       1 black XOR   2 black XOR + an arrow that stays   3 black   above 3 colour(mode - 3) XOR

Numbers are the wire's tenths. A shape in XOR that is drawn again is gone, as on a screen; whoever draws it.

Where the robots have been: the track of each actual robot, and of where its encoders believed it was.

Rules: a point is kept where the last one is POINT_IN away or more, as time passes; the oldest of
MOST_POINTS is forgotten for a new one. Inches. Who drives and who looks is not known here.
Robots that drive for days fill their tracks: a coordinate is kept in eight bytes, not as an object of Python's.
"""

from __future__ import annotations

from array import array
from base64 import b64decode, b64encode
from bisect import bisect_left
from collections import deque
from collections.abc import Iterable
from enum import StrEnum
from itertools import takewhile
from math import floor, hypot
from typing import Final, NamedTuple

import numpy as np

from nserver_emu.server.limits import Limits
from nserver_emu.simulation.simulation import Simulation

BLACK: Final = "Black"
COLOURS: Final = (
    "Blue", "NavyBlue", "RoyalBlue", "SteelBlue", "CadetBlue", "Green", "SeaGreen", "ForestGreen", "DarkGreen",
    "LimeGreen", "Yellow", "Orange", "LightCoral", "DeepPink", "OrangeRed", "Red", "IndianRed", "VioletRed",
    "DeepPink", "Maroon",
)  # fmt: skip
"""Colour number 1 is the first."""

MOST_GONE: Final = 1000
"""Shapes that went of which it is known when; whoever looked last before that looks at all anew."""


class Layer(StrEnum):
    """The parts of the window that a client can have redrawn."""

    ACTUAL_TRACE = "actual_trace"
    ENCODER_TRACE = "encoder_trace"
    BUMPER = "bumper"
    INFRARED = "infrared"
    SONAR = "sonar"
    LASER = "laser"
    CLIENT = "client_graphics"


class Figure(StrEnum):
    """What a shape is."""

    LINE = "line"
    ARC = "arc"
    ROBOT = "robot"
    ARROW = "arrow"


class Shape(NamedTuple):
    """Something drawn: its numbers in tenths (lengths 1/10 inch, angles 1/10 degree), its colour by name."""

    figure: Figure
    numbers: tuple[int, ...]
    colour: str
    xor: bool


class GraphicsState(NamedTuple):
    """The client graphics in a snapshot: shapes and removals with the numbers of their drawings."""

    drawn: int
    redrawn: dict[Layer, int]
    shapes: tuple[tuple[int, Shape], ...]
    removed: tuple[tuple[int, int], ...]


class Graphics:
    """The client graphics, and how often each layer was to be redrawn."""

    drawn: int = 0
    """How often something was drawn: while it stays, so do the shapes."""

    def __init__(self) -> None:
        self.redrawn: dict[Layer, int] = dict.fromkeys(Layer, 0)
        self._shapes: dict[Shape, int] = {}
        self._gone: deque[tuple[int, int]] = deque(maxlen=MOST_GONE)

    @property
    def shapes(self) -> tuple[Shape, ...]:
        """What stands in the window, in the order in which it was drawn."""
        return tuple(self._shapes)

    @property
    def numbered(self) -> list[tuple[int, Shape]]:
        """The same, each with the number of the drawing that put it there."""
        return [(number, shape) for shape, number in self._shapes.items()]

    def changes(self, drawn: int, until: int) -> tuple[list[int], list[tuple[int, Shape]]] | None:
        """What changed since `drawn` was so much until it was `until`: the numbers of shapes that went, and the shapes
        that came, but for those that have gone since. None where that is not known any more.
        """
        if len(self._gone) == MOST_GONE and self._gone[0][0] > drawn:
            return None
        gone = [n for when, n in takewhile(lambda one: one[0] > drawn, reversed(self._gone)) if when <= until]
        come = takewhile(lambda one: one[1] > drawn, reversed(self._shapes.items()))
        come_then = [(number, shape) for shape, number in come if number <= until]
        return [number for number in gone if number <= drawn], come_then[::-1]

    def draw(self, figure: Figure, numbers: tuple[int, ...], mode: int, most: int = Limits().graphics) -> None:
        """Draw a line, an arc or a robot in a mode; modes out of range count as the nearest there is.

        `most`: shapes kept; the oldest is forgotten for a new one, so that who draws for days fills no memory.
        """
        if figure is not Figure.ROBOT:
            self._put(Shape(figure, numbers, *_line_mode(mode)), most)
            return
        self._put(Shape(figure, numbers, *_robot_mode(mode)), most)
        if mode == 2:
            self._put(Shape(Figure.ARROW, numbers, BLACK, xor=False), most)

    def redraw(self, *layers: Layer) -> None:
        """A client wants these layers drawn anew."""
        for layer in layers:
            self.redrawn[layer] += 1

    def _put(self, shape: Shape, most: int) -> None:
        self.drawn += 1
        if shape in self._shapes:
            self._take(shape)
            if shape.xor:
                return
        self._shapes[shape] = self.drawn
        while len(self._shapes) > most:
            self._take(next(iter(self._shapes)))

    def _take(self, shape: Shape) -> None:
        self._gone.append((self.drawn, self._shapes.pop(shape)))

    def to_state(self) -> GraphicsState:
        """Return all that changes."""
        return GraphicsState(self.drawn, self.redrawn, tuple(self.numbered), tuple(self._gone))

    @classmethod
    def from_state(cls, state: GraphicsState) -> Graphics:
        """Return the graphics of a state."""
        graphics = cls()
        graphics.drawn = state.drawn
        graphics.redrawn |= state.redrawn
        graphics._shapes = {shape: number for number, shape in state.shapes}
        graphics._gone.extend(state.removed)
        return graphics


def _line_mode(mode: int) -> tuple[str, bool]:
    return (_colour(mode - 2), True) if mode > 2 else (BLACK, mode == 2)


def _robot_mode(mode: int) -> tuple[str, bool]:
    return (_colour(mode - 3), True) if mode > 3 else (BLACK, mode != 3)


def _colour(number: int) -> str:
    return COLOURS[min(number, len(COLOURS)) - 1]


POINT_IN: Final = 0.5
"""Nearer points look like one."""

INTERVAL_S: Final = 0.025
"""Nobody goes farther than that in less time at 20 in/s: it is not looked more often."""

MOST_POINTS: Final = 4000
"""At least 2000 inches of way; some days of clients fill no memory."""

FORGOTTEN_AT_ONCE: Final = 400
"""Points; a track moves up in memory when it forgets its oldest."""

JUMP_IN: Final = 6.0
"""Points farther apart were not driven: half again what the fastest wheels make in a tenth of a second."""


class TraceState(NamedTuple):
    """A track in a snapshot: the coordinates x y as base64 of little-endian doubles, because there are thousands."""

    points: str
    total: int
    jumps: tuple[int, ...]


class TracesState(NamedTuple):
    """All tracks in a snapshot."""

    actual: dict[int, TraceState]
    encoder: dict[int, TraceState]
    interval: int


class Trace:
    """A track as points; coordinates one after another, which a snapshot keeps in little room."""

    gone: int = 0
    """How many points there were so far, those forgotten as well: the number of the last one."""

    jumps: tuple[int, ...] = ()
    """The numbers of those that the robot did not drive to but was put down at, as long as they are kept."""

    def __init__(self) -> None:
        self._flat = array("d")

    @property
    def points(self) -> list[tuple[float, float]]:
        """(x, y) in inches, the oldest first."""
        flat = iter(self._flat[-2 * MOST_POINTS :])
        return list(zip(flat, flat, strict=True))

    @property
    def first(self) -> int:
        """The number of the oldest that is kept."""
        return self.gone - min(len(self._flat) // 2, MOST_POINTS) + 1

    def at(self, numbers: Iterable[int]) -> list[tuple[float, float]]:
        """(x, y) in inches of those with these numbers, which are kept; however many others there are."""
        flat, first = self._flat, self.gone - len(self._flat) // 2 + 1
        return [(flat[2 * (number - first)], flat[2 * (number - first) + 1]) for number in numbers]

    def go(self, x_in: float, y_in: float) -> None:
        """The robot is here."""
        way_in = hypot(x_in - self._flat[-2], y_in - self._flat[-1]) if self._flat else POINT_IN
        if way_in >= POINT_IN:
            self._flat.extend((x_in, y_in))
            self.gone += 1
            if len(self._flat) >= 2 * (MOST_POINTS + FORGOTTEN_AT_ONCE):
                del self._flat[: 2 * FORGOTTEN_AT_ONCE]
            if way_in > JUMP_IN:
                self.jumps = (*self.jumps[bisect_left(self.jumps, self.first) :], self.gone)

    def to_state(self) -> TraceState:
        """Return all that changes."""
        points = b64encode(np.array(self._flat, dtype="<f8").tobytes()).decode()
        return TraceState(points, self.gone, self.jumps)

    @classmethod
    def from_state(cls, state: TraceState) -> Trace:
        """Return the track of a state; raise ValueError if it is not one."""
        flat = np.frombuffer(b64decode(state.points, validate=True), dtype="<f8")
        if len(flat) % 2 or not np.isfinite(flat).all() or state.total < len(flat) // 2:
            raise ValueError("a track without points")
        trace = cls()
        trace._flat = array("d", flat.tolist())
        trace.gone, trace.jumps = state.total, state.jumps
        return trace


class Traces:
    """The two tracks of each robot by its number: `actual` and `encoder`."""

    def __init__(self) -> None:
        self.actual: dict[int, Trace] = {}
        self.encoder: dict[int, Trace] = {}
        self._noted = -1

    def note(self, simulation: Simulation) -> None:
        """This is where all are now; of several moments within INTERVAL_S the first counts."""
        interval = floor(simulation.time_s / INTERVAL_S)
        if interval == self._noted:
            return
        self._noted = interval
        for robot_id, robot in simulation.robots.items():
            x, y, _ = robot.disc
            believed = robot.encoder
            self.actual.setdefault(robot_id, Trace()).go(x, y)
            self.encoder.setdefault(robot_id, Trace()).go(believed.x_in, believed.y_in)

    def to_state(self) -> TracesState:
        """Return all that changes."""
        actual = {robot_id: trace.to_state() for robot_id, trace in self.actual.items()}
        encoder = {robot_id: trace.to_state() for robot_id, trace in self.encoder.items()}
        return TracesState(actual, encoder, self._noted)

    @classmethod
    def from_state(cls, state: TracesState) -> Traces:
        """Return the tracks of a state; raise ValueError if they are none."""
        traces = cls()
        traces.actual = {robot_id: Trace.from_state(trace) for robot_id, trace in state.actual.items()}
        traces.encoder = {robot_id: Trace.from_state(trace) for robot_id, trace in state.encoder.items()}
        traces._noted = state.interval
        return traces
