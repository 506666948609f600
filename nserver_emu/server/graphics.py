"""Client graphics in a robot's window, and the traces of driven robots. No I/O.

    shape       line x1 y1 x2 y2 | arc x0 y0 w h th1 th2 | robot x y steer turret | arrow x y steer turret
    mode        line, arc   1 black   2 black XOR              above 2 colour(mode - 2) XOR
                robot       1 black XOR   2 black XOR + a permanent arrow   3 black   above 3 colour(mode - 3) XOR

Shapes are in tenths as on the wire. An XOR shape drawn a second time disappears, as on a screen, whichever client
draws it. Traces are in inches.
"""

from __future__ import annotations

from array import array
from base64 import b64decode, b64encode
from bisect import bisect_left
from collections import deque
from collections.abc import Iterable, Mapping
from enum import StrEnum
from itertools import takewhile
from math import floor, hypot
from typing import Final, NamedTuple

import numpy as np

from nserver_emu.server.admission import Limits
from nserver_emu.simulation.robot import SimulatedRobot

BLACK: Final = "Black"
# Colours by number, starting with 1.
COLOURS: Final = (
    "Blue", "NavyBlue", "RoyalBlue", "SteelBlue", "CadetBlue", "Green", "SeaGreen", "ForestGreen", "DarkGreen",
    "LimeGreen", "Yellow", "Orange", "LightCoral", "DeepPink", "OrangeRed", "Red", "IndianRed", "VioletRed",
    "DeepPink", "Maroon",
)  # fmt: skip

# Removals remembered for incremental updates; a viewer that is further behind gets all shapes.
MAX_REMOVALS: Final = 1000


class Figure(StrEnum):
    """Kinds of shapes."""

    LINE = "line"
    ARC = "arc"
    ROBOT = "robot"
    ARROW = "arrow"


# Number of a shape's numbers by its figure, and their largest magnitude.
NUMBERS: Final = {Figure.LINE: 4, Figure.ARC: 6, Figure.ROBOT: 4, Figure.ARROW: 4}
MAX_WORD: Final = 1 << 31


class Shape(NamedTuple):
    """A drawn shape: numbers in tenths (1/10 inch, 1/10 degree), colour by name."""

    figure: Figure
    numbers: tuple[int, ...]
    colour: str
    xor: bool


class GraphicsState(NamedTuple):
    """The client graphics in a snapshot: shapes and removals with their revisions."""

    drawn: int
    # Former versions counted requests to redraw a layer; nothing reads these numbers.
    redrawn: dict[str, int]
    shapes: tuple[tuple[int, Shape], ...]
    removed: tuple[tuple[int, int], ...]


class Graphics:
    """The client graphics."""

    # Number of drawing operations: the revision of the shapes.
    drawn: int = 0

    def __init__(self) -> None:
        self._shapes: dict[Shape, int] = {}
        # Revision at which a shape was removed, and the revision that had drawn it.
        self._removed: deque[tuple[int, int]] = deque(maxlen=MAX_REMOVALS)

    @property
    def shapes(self) -> tuple[Shape, ...]:
        """All shapes in the order in which they were drawn."""
        return tuple(self._shapes)

    @property
    def numbered(self) -> list[tuple[int, Shape]]:
        """All shapes, each with the revision at which it was drawn."""
        return [(number, shape) for shape, number in self._shapes.items()]

    def changes(self, drawn: int, until: int) -> tuple[list[int], list[tuple[int, Shape]]] | None:
        """Return the changes between revisions `drawn` and `until`.

        Returns
        -------
        tuple or None
            Revisions of the removed shapes, and the added shapes that still exist with theirs; None if the removals
            are not remembered that far back.
        """
        if len(self._removed) == MAX_REMOVALS and self._removed[0][0] > drawn:
            return None
        removed = [n for when, n in takewhile(lambda one: one[0] > drawn, reversed(self._removed)) if when <= until]
        added = takewhile(lambda one: one[1] > drawn, reversed(self._shapes.items()))
        added_then = [(number, shape) for shape, number in added if number <= until]
        return [number for number in removed if number <= drawn], added_then[::-1]

    def draw(self, figure: Figure, numbers: tuple[int, ...], mode: int, max_shapes: int = Limits().graphics) -> None:
        """Draw a line, an arc or a robot; a mode out of range is clamped.

        Beyond `max_shapes` the oldest shape is removed, so that clients that draw for days do not fill memory.
        """
        if figure is not Figure.ROBOT:
            self._add(Shape(figure, numbers, *_line_mode(mode)), max_shapes)
            return
        self._add(Shape(figure, numbers, *_robot_mode(mode)), max_shapes)
        if mode == 2:
            self._add(Shape(Figure.ARROW, numbers, BLACK, xor=False), max_shapes)

    def _add(self, shape: Shape, max_shapes: int) -> None:
        self.drawn += 1
        if shape in self._shapes:
            self._remove(shape)
            if shape.xor:
                return
        self._shapes[shape] = self.drawn
        while len(self._shapes) > max_shapes:
            self._remove(next(iter(self._shapes)))

    def _remove(self, shape: Shape) -> None:
        self._removed.append((self.drawn, self._shapes.pop(shape)))

    def to_state(self) -> GraphicsState:
        """Return the state for a snapshot."""
        return GraphicsState(self.drawn, {}, tuple(self.numbered), tuple(self._removed))

    @classmethod
    def from_state(cls, state: GraphicsState) -> Graphics:
        """Return the graphics of a state. Raise ValueError if it is invalid."""
        # 1. Revisions: in order, and none after the last.
        for numbers in ([number for number, _ in state.shapes], [when for when, _ in state.removed]):
            if numbers != sorted(numbers) or (numbers and not 0 < numbers[0] <= numbers[-1] <= state.drawn):
                raise ValueError("graphics with revisions out of order")
        if len(state.removed) > MAX_REMOVALS:
            raise ValueError("graphics that were removed too often")
        # 2. Shapes.
        for _, shape in state.shapes:
            if len(shape.numbers) != NUMBERS[shape.figure] or shape.colour not in (BLACK, *COLOURS):
                raise ValueError(f"a {shape.figure.value} that cannot be drawn")
            if not all(abs(number) <= MAX_WORD for number in shape.numbers):
                raise ValueError(f"a {shape.figure.value} beyond the numbers of a request")
        graphics = cls()
        graphics.drawn = state.drawn
        graphics._shapes = {shape: number for number, shape in state.shapes}
        graphics._removed.extend(state.removed)
        return graphics


def _line_mode(mode: int) -> tuple[str, bool]:
    return (_colour(mode - 2), True) if mode > 2 else (BLACK, mode == 2)


def _robot_mode(mode: int) -> tuple[str, bool]:
    return (_colour(mode - 3), True) if mode > 3 else (BLACK, mode != 3)


def _colour(number: int) -> str:
    return COLOURS[min(number, len(COLOURS)) - 1]


# Traces.

# Minimum distance of two points: closer ones cannot be distinguished in the window.
POINT_SPACING_IN: Final = 0.5
# Time between samples: a robot at 20 in/s drives less than POINT_SPACING_IN meanwhile.
INTERVAL_S: Final = 0.025
# At least 2000 inches of path per robot.
MAX_POINTS: Final = 4000
# Points removed together when a trace is full, because each removal moves the rest in memory.
REMOVED_TOGETHER: Final = 400
# Points farther apart are a placement, not a motion: 1.5 times the path of the fastest wheels in 0.1 s.
JUMP_IN: Final = 6.0


class TraceState(NamedTuple):
    """A trace in a snapshot: coordinates x y as base64 of little-endian doubles, because there are thousands."""

    points: str
    total: int
    jumps: tuple[int, ...]


class TracesState(NamedTuple):
    """All traces in a snapshot."""

    actual: dict[int, TraceState]
    encoder: dict[int, TraceState]
    interval: int


class Trace:
    """The path of one robot as points, stored as a flat array of doubles (8 bytes a coordinate)."""

    # Number of points so far, removed ones included: the number of the last point.
    count: int = 0
    # Numbers of stored points at which the robot was placed instead of driving there.
    jumps: tuple[int, ...] = ()

    def __init__(self) -> None:
        self._flat = array("d")

    @property
    def points(self) -> list[tuple[float, float]]:
        """Stored points (x, y) in inches, oldest first."""
        flat = iter(self._flat[-2 * MAX_POINTS :])
        return list(zip(flat, flat, strict=True))

    @property
    def first(self) -> int:
        """Number of the oldest stored point."""
        return self.count - min(len(self._flat) // 2, MAX_POINTS) + 1

    def at(self, numbers: Iterable[int]) -> list[tuple[float, float]]:
        """Return stored points (x, y) in inches by their numbers."""
        flat, first = self._flat, self.count - len(self._flat) // 2 + 1
        return [(flat[2 * (number - first)], flat[2 * (number - first) + 1]) for number in numbers]

    def add(self, x_in: float, y_in: float) -> None:
        """Add a position in inches, if it is far enough from the last point."""
        distance_in = hypot(x_in - self._flat[-2], y_in - self._flat[-1]) if self._flat else POINT_SPACING_IN
        if distance_in >= POINT_SPACING_IN:
            self._flat.extend((x_in, y_in))
            self.count += 1
            if len(self._flat) >= 2 * (MAX_POINTS + REMOVED_TOGETHER):
                del self._flat[: 2 * REMOVED_TOGETHER]
            if distance_in > JUMP_IN:
                self.jumps = (*self.jumps[bisect_left(self.jumps, self.first) :], self.count)

    def to_state(self) -> TraceState:
        """Return the state for a snapshot."""
        points = b64encode(np.array(self._flat, dtype="<f8").tobytes()).decode()
        return TraceState(points, self.count, self.jumps)

    @classmethod
    def from_state(cls, state: TraceState) -> Trace:
        """Return the trace of a state. Raise ValueError if it is invalid."""
        flat = np.frombuffer(b64decode(state.points, validate=True), dtype="<f8")
        if len(flat) % 2 or not np.isfinite(flat).all() or state.total < len(flat) // 2:
            raise ValueError("a trace without points")
        if len(flat) > 2 * (MAX_POINTS + REMOVED_TOGETHER) or not (np.abs(flat) <= MAX_WORD).all():
            raise ValueError("a trace with too many points, or beyond the map")
        if list(state.jumps) != sorted(state.jumps) or not all(0 < number <= state.total for number in state.jumps):
            raise ValueError("a trace with jumps that are none of its points")
        trace = cls()
        trace._flat = array("d", flat.tolist())
        trace.count, trace.jumps = state.total, state.jumps
        return trace


class Traces:
    """Traces of each robot by its number: the actual path, and the path according to its encoders."""

    def __init__(self) -> None:
        self.actual: dict[int, Trace] = {}
        self.encoder: dict[int, Trace] = {}
        self._interval = -1

    def update(self, time_s: float, robots: Mapping[int, SimulatedRobot]) -> None:
        """Add the positions of all robots, at most once per INTERVAL_S."""
        interval = floor(time_s / INTERVAL_S)
        if interval == self._interval:
            return
        self._interval = interval
        for robot_id, robot in robots.items():
            if robot_id not in self.actual:
                self.actual[robot_id], self.encoder[robot_id] = Trace(), Trace()
            x, y, _ = robot.disc
            self.actual[robot_id].add(x, y)
            encoder = robot.encoder
            self.encoder[robot_id].add(encoder.x_in, encoder.y_in)

    def to_state(self) -> TracesState:
        """Return the state for a snapshot."""
        actual = {robot_id: trace.to_state() for robot_id, trace in self.actual.items()}
        encoder = {robot_id: trace.to_state() for robot_id, trace in self.encoder.items()}
        return TracesState(actual, encoder, self._interval)

    @classmethod
    def from_state(cls, state: TracesState) -> Traces:
        """Return the traces of a state. Raise ValueError if it is invalid."""
        traces = cls()
        traces.actual = {robot_id: Trace.from_state(trace) for robot_id, trace in state.actual.items()}
        traces.encoder = {robot_id: Trace.from_state(trace) for robot_id, trace in state.encoder.items()}
        traces._interval = state.interval
        return traces


# tk: speech output of robots.

# Older utterances are dropped, so that clients that speak for days do not fill memory.
MAX_UTTERANCES: Final = 1000


class Utterance(NamedTuple):
    """A text spoken by a robot."""

    # Simulated seconds.
    time_s: float
    robot_id: int
    text: str
