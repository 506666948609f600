"""What clients have drawn into the window, and which layers they asked to be redrawn. Pure; whoever shows it reads it.

    layer       actual_trace | encoder_trace | bumper | infrared | sonar | laser | client_graphics
    shape       line x1 y1 x2 y2 | arc x0 y0 w h th1 th2 | robot x y steer turret | arrow x y steer turret
    mode        line, arc   1 black   2 black XOR              above 2 colour(mode - 2) XOR
                robot       1 black XOR   2 black XOR + an arrow that stays   3 black   above 3 colour(mode - 3) XOR

Numbers are the wire's tenths. A shape in XOR that is drawn again is gone, as on a screen; whoever draws it.
"""

from __future__ import annotations

from collections import deque
from enum import StrEnum
from itertools import takewhile
from typing import Final, NamedTuple

from nserver_emu.server.admission.limits import Limits

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


def _line_mode(mode: int) -> tuple[str, bool]:
    return (_colour(mode - 2), True) if mode > 2 else (BLACK, mode == 2)


def _robot_mode(mode: int) -> tuple[str, bool]:
    return (_colour(mode - 3), True) if mode > 3 else (BLACK, mode != 3)


def _colour(number: int) -> str:
    return COLOURS[min(number, len(COLOURS)) - 1]
