"""Settings: several robots, models from files, and who finds no room."""

from __future__ import annotations

from math import hypot
from pathlib import Path

import pytest

from nclient.errors import AddressError, StartError
from nserver_emu.server.config import SimulationConfig, pose_from_text
from worlds.world import StartPose


def test_one_n150_in_the_room_of_the_thesis_is_the_rule() -> None:
    robots = SimulationConfig().simulation().robots
    assert {number: robot.model.name for number, robot in robots.items()} == {1: "n150"}


def test_robots_with_and_without_a_start() -> None:
    others = (("scout", StartPose(60.0, 60.0)), ("n200", None), ("n200", None))
    robots = SimulationConfig(others=others).simulation().robots
    assert [robot.model.name for robot in robots.values()] == ["n150", "scout", "n200", "n200"]
    assert robots[2].actual[:2] == (60.0, 60.0)
    discs = [robot.disc for robot in robots.values()]
    for at, (x, y, radius) in enumerate(discs):
        assert all(hypot(x - u, y - v) > radius + other for u, v, other in discs[:at])


def test_a_robot_without_space_is_an_error() -> None:
    with pytest.raises(StartError, match="robot"):
        SimulationConfig(others=(("n150", None),) * 60).simulation()
    with pytest.raises(StartError, match="touches robot 1"):
        SimulationConfig(others=(("n150", StartPose(10.0, 0.0)),)).simulation()


def test_models_of_a_file(tmp_path: Path) -> None:
    path = tmp_path / "models.toml"
    path.write_text('[[model]]\nname = "small"\nlike = "n200"\nradius_in = 6\n', encoding="utf-8")
    robot = SimulationConfig(robot="Small", model_file=path).simulation().robots[1]
    assert (robot.model.name, robot.model.family, robot.model.body.radius_in) == ("small", "n200", 6.0)
    with pytest.raises(AddressError, match=r"'small'.* n150, n200, scout"):
        SimulationConfig(robot="small").simulation()


def test_sonars_see_at_power_on_robots_with_higher_numbers_too() -> None:
    places = (StartPose(0.0, 0.0), StartPose(40.0, 0.0))
    one, other = (
        SimulationConfig(start=places[first], others=(("n150", places[1 - first]),)).simulation().robots
        for first in (0, 1)
    )
    assert one[1].sonar.readings_in == other[2].sonar.readings_in
    assert one[2].sonar.readings_in == other[1].sonar.readings_in
    gap_in = 40.0 - one[1].disc[2] - one[1].model.body.sonar_ring_radius_in
    assert one[1].sonar.readings_in[0] == one[2].sonar.readings_in[8] == round(gap_in)


@pytest.mark.parametrize("text", ["10", "1,2,3,4,5", "a,b", "nan,1", "inf,1", "10,1e308", "1e6,0", "1,2,1e999"])
def test_a_start_beyond_the_map_is_an_error(text: str) -> None:
    with pytest.raises(AddressError, match=r"X,Y,STEER,TURRET .* 100000.*got"):
        pose_from_text(text)
