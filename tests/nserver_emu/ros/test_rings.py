"""Topics and frames of robots whose sonars are not a Nomad's."""

from __future__ import annotations

import math

import pytest

from nclient.recording.ros_messages import RANGE, SCAN, Message
from nserver_emu.ros import topics
from nserver_emu.ros.topics import Estimates, RobotReader
from nserver_emu.server.daemon import Daemon
from nserver_emu.server.handlers.table import Emulator
from nserver_emu.simulation.models import RobotModel, parse_models
from nserver_emu.simulation.noise import IDEAL
from nserver_emu.simulation.simulation import Simulation
from nserver_emu.viewer.clients import ErrorBoundary
from worlds.io import load_world
from worlds.world import StartPose


def model(ring: str) -> RobotModel:
    return parse_models(f'[[model]]\nname = "mine"\nlike = "n150"\n[model.ring]\n{ring}\n', "m.toml")["mine"]


MOUNTED = model("""
angles_deg = [-90, 0, 100]
mounts_in = [[2, -8], [10, 1], [0, 9]]
half_cone_deg = 15
min_range_cm = 15
max_range_m = 1.3
no_echo_m = 5.11
resolution_cm = 1
""")
# Five sonars at equal angles, but not all around.
EVEN = model("angles_deg = [-60, -30, 0, 30, 60]")


async def published(one: RobotModel) -> tuple[Simulation, dict[str, Message]]:
    """Return the topics of one reading of a robot, and its frames."""
    simulation = Simulation(load_world("thesis_room"))
    simulation.add_robot(1, StartPose(40.0, 45.0, 0.0, 0.0), one, IDEAL)
    simulation.step(2.0)
    daemon = Daemon(Emulator(simulation))
    found: dict[str, Message] = {}
    reader = RobotReader(daemon, "test", ErrorBoundary(), found.__setitem__, Estimates())
    reader.read(1)
    found["/tf_static"] = reader.static_frames()
    reader.close()
    await daemon.close()
    return simulation, found


async def test_unequal_angles_have_ranges_and_frames() -> None:
    simulation, found = await published(MOUNTED)
    readings_in = simulation.robots[1].sonar.readings_in
    # 1. Each sonar has a topic; a LaserScan has no room for these angles.
    ranges = [found[f"/robot1/sonar/{k}"] for k in range(3)]
    assert [name for name in found if "sonar" in name] == [f"/robot1/sonar/{k}" for k in range(3)]
    # 2. Centimetres, as State does not have them; without an echo +inf.
    for message, reading_in in zip(ranges, readings_in, strict=True):
        expected = math.inf if reading_in * 0.0254 == pytest.approx(5.11) else reading_in * 0.0254
        assert message["range"] == pytest.approx(expected)
    measured = [one["range"] for one in ranges if math.isfinite(one["range"])]
    # Some sonars have an echo within 1.3 m, not all.
    assert 0 < len(measured) < 3
    assert all(one * 100 == pytest.approx(round(one * 100)) for one in measured)
    assert ranges[0]["field_of_view"] == pytest.approx(math.radians(30.0))
    assert (ranges[0]["min_range"], ranges[0]["max_range"]) == pytest.approx((0.15, 1.3))
    # 3. Frames are at the mounts.
    frames = [one["transform"] for one in found["/tf_static"]["transforms"]]
    places = [(one["translation"]["x"], one["translation"]["y"]) for one in frames]
    assert places == [pytest.approx((x * 0.0254, y * 0.0254)) for x, y in ((2, -8), (10, 1), (0, 9))]
    # Yaw of a quaternion without roll and pitch.
    turns = [2.0 * math.atan2(one["rotation"]["z"], one["rotation"]["w"]) for one in frames]
    assert turns == pytest.approx([math.radians(angle) for angle in (-90, 0, 100)])


async def test_equal_angles_are_a_scan() -> None:
    simulation, found = await published(EVEN)
    scan, readings_in = found["/robot1/sonar"], simulation.robots[1].sonar.readings_in
    assert (scan["angle_min"], scan["angle_max"]) == pytest.approx((-math.pi / 3, math.pi / 3))
    assert scan["angle_increment"] == pytest.approx(math.pi / 6)
    ring_m = EVEN.body.ring.radius_in * 0.0254
    expected = [math.inf if one >= 255 else one * 0.0254 + ring_m for one in readings_in]
    assert scan["ranges"] == pytest.approx(expected)
    assert "/robot1/sonar/5" not in found


def test_listed_topics_are_those_that_are_published() -> None:
    types = topics.topic_types({1: MOUNTED.body.ring, 2: EVEN.body.ring})
    assert "/robot1/sonar" not in types
    assert types["/robot2/sonar"] == SCAN
    assert [name for name, kind in types.items() if kind == RANGE] == [
        *(f"/robot1/sonar/{k}" for k in range(3)), *(f"/robot2/sonar/{k}" for k in range(5))
    ]  # fmt: skip
