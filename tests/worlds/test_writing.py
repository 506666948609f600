"""A world as text, and back."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from worlds.files import load_world, parse_world, world_names
from worlds.world import Path, Polygon, StartPose, World
from worlds.writing import world_text


def same(one: World, other: World) -> bool:
    return (
        (one.name, one.title, one.rooms, one.obstacles, dict(one.paths)) ==
        (other.name, other.title, other.rooms, other.obstacles, dict(other.paths))
        and one.walls.tolist() == other.walls.tolist()
        and np.allclose([list(_numbers(start)) for start in one.starts], [list(_numbers(s)) for s in other.starts])
    )  # fmt: skip


def _numbers(start: StartPose) -> tuple[float, float, float, float]:
    return start.x_in, start.y_in, start.steering_rad, start.turret_rad


@pytest.mark.parametrize("name", world_names())
def test_shipped_worlds_come_back(name: str) -> None:
    world = load_world(name)
    assert same(parse_world(world_text(world, "of mine\ntwice"), "there.toml", "else"), world)


def test_all_that_a_world_may_have_comes_back() -> None:
    start = StartPose(10.0, 20.0, 0.5, -0.25)
    ring = Polygon(((0.0, 0.0), (100.0, 0.0), (100.0, 1 / 3 + 90), (0.0, 90.0)), 'the "hall"\n\x7f\\')
    block = Polygon(((50.0, 50.0), (60.0, 50.0), (60.0, 60.0)), "block")
    world = World(
        "grüße", "", (ring,), np.array([[1, 50, 5, 50], [5, 50, 5, 60], [7, 70, 9, 70]], dtype=np.float64), (block,),
        (StartPose(30.0, 30.0), start),
        {"round": Path("round", "", StartPose(40.0, 40.0), ((40.0, 40.0), (45.0, 40.0))),
         "5.1": Path("about", "5.1", StartPose(30.0, 30.0), ((30.0, 30.0), (30.0, 35.0)))},
    )  # fmt: skip
    text = world_text(world)
    assert "points_in = [[1.0, 50.0], [5.0, 50.0], [5.0, 60.0]]" in text
    back = parse_world(text, "there.toml", "else")
    assert back.title == "grüße"
    assert same(back, replace(world, title="grüße"))
