"""The window's layers as plain data: modes, colours, shapes that XOR takes away."""

from __future__ import annotations

import pytest

from nserver_emu.server import graphics
from nserver_emu.server.graphics import BLACK, COLOURS, Figure, Graphics, Shape

LINE = (0, 0, 100, 200)
POSE = (10, 20, 900, 450)


@pytest.fixture
def window() -> Graphics:
    return Graphics()


def test_there_are_the_twenty_colours_of_the_protocol() -> None:
    assert len(COLOURS) == 20
    assert (COLOURS[0], COLOURS[4], COLOURS[10], COLOURS[19]) == ("Blue", "CadetBlue", "Yellow", "Maroon")


@pytest.mark.parametrize(
    ("mode", "colour", "xor"),
    [(1, BLACK, False), (2, BLACK, True), (3, "Blue", True), (22, "Maroon", True), (99, "Maroon", True),
     (0, BLACK, False), (-5, BLACK, False)],
)  # fmt: skip
def test_modes_of_lines_and_arcs(window: Graphics, mode: int, colour: str, xor: bool) -> None:
    window.draw(Figure.LINE, LINE, mode)
    window.draw(Figure.ARC, (0, 0, 5, 5, 0, 900), mode)
    assert window.shapes == (
        Shape(Figure.LINE, LINE, colour, xor), Shape(Figure.ARC, (0, 0, 5, 5, 0, 900), colour, xor)
    )  # fmt: skip


@pytest.mark.parametrize(
    ("mode", "colour", "xor"),
    [(1, BLACK, True), (3, BLACK, False), (4, "Blue", True), (23, "Maroon", True), (0, BLACK, True)],
)
def test_modes_of_robots(window: Graphics, mode: int, colour: str, xor: bool) -> None:
    window.draw(Figure.ROBOT, POSE, mode)
    assert window.shapes == (Shape(Figure.ROBOT, POSE, colour, xor),)


def test_drawing_a_robot_twice_leaves_its_arrow(window: Graphics) -> None:
    window.draw(Figure.ROBOT, POSE, 2)
    assert [shape.figure for shape in window.shapes] == [Figure.ROBOT, Figure.ARROW]
    window.draw(Figure.ROBOT, POSE, 2)
    assert window.shapes == (Shape(Figure.ARROW, POSE, BLACK, xor=False),)


def test_pairs_in_xor_erase_and_pairs_in_black_do_not(window: Graphics) -> None:
    for _ in range(2):
        window.draw(Figure.LINE, LINE, 1)
    assert len(window.shapes) == 1
    for count in (2, 1, 2, 1):
        window.draw(Figure.LINE, LINE, 5)
        assert len(window.shapes) == count


def test_another_colour_erases_nothing(window: Graphics) -> None:
    window.draw(Figure.LINE, LINE, 3)
    window.draw(Figure.LINE, LINE, 4)
    assert [shape.colour for shape in window.shapes] == ["Blue", "NavyBlue"]


def test_the_oldest_shape_makes_room(window: Graphics) -> None:
    for number in range(5):
        window.draw(Figure.LINE, (number, 0, 0, 0), 1, max_shapes=3)
    assert [shape.numbers[0] for shape in window.shapes] == [2, 3, 4]


def test_what_changed_since_is_what_went_and_what_came(window: Graphics) -> None:
    had: list[tuple[int, list[tuple[int, Shape]]]] = []
    for number in range(30):
        had.append((window.drawn, window.numbered))
        window.draw(Figure.LINE, (number * number % 7, 0, 0, 0), 1 + number % 3, max_shapes=3)
    for drawn, shapes in had:
        changes = window.changes(drawn, window.drawn)
        assert changes is not None
        gone, come = changes
        assert [shape for shape in shapes if shape[0] not in gone] + come == window.numbered


def test_old_changes_are_dropped(window: Graphics) -> None:
    for number in range(2 * graphics.MAX_REMOVALS):
        window.draw(Figure.LINE, LINE, 2)
        if number == 100:
            assert window.changes(0, window.drawn) == ([], window.numbered)
    assert window.changes(0, window.drawn) is None
    assert window.changes(window.drawn - 1, window.drawn) == ([window.drawn - 1], [])
