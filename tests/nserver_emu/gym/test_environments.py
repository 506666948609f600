"""Environments of one robot: checks of Gymnasium and PettingZoo, quantities in SI units, rewards, ends, pictures."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from math import atan2, cos, hypot, pi, sin
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from pettingzoo.test import parallel_api_test

import nserver_emu.gym as package
from nserver_emu.gym import RandomPolicy, RobotEnv, WallFollower, parallel_env, run_episode
from nserver_emu.gym.environments import explore, go_to
from nserver_emu.gym.tasks import Explore, GoTo, beam_points
from worlds.rings import nomad_ring
from worlds.world import Polygon, World

ROOM = World("box", rooms=(Polygon(((-60.0, -60.0), (60.0, -60.0), (60.0, 60.0), (-60.0, 60.0))),))
"""A square of 120 in around the origin: its walls are 1.524 m away."""
WALL_M, RING_M = 60 * 0.0254, 9.06 * 0.0254
STAND = np.zeros(2, dtype=np.float32)


def in_room(**options: Any) -> RobotEnv:
    return go_to(world=ROOM, setup="ideal", **options)


@pytest.mark.parametrize("name", ["GoTo", "Explore", "Localize"])
def test_environment_passes_the_check_of_gymnasium(name: str) -> None:
    env = gymnasium.make(f"Nomad/{name}-v0", render_mode="rgb_array", world="thesis_room")
    check_env(env.unwrapped)
    env.close()


def test_parallel_environment_passes_the_test_of_pettingzoo(capsys: pytest.CaptureFixture[str]) -> None:
    env: Any = parallel_env(robots=3, max_steps=12, render_mode="rgb_array")
    parallel_api_test(env, num_cycles=30)
    assert "Passed" in capsys.readouterr().out
    assert env.render().shape[2] == 3


@pytest.mark.long
def test_the_same_seed_gives_the_same_episode() -> None:
    env = gymnasium.make("Nomad/GoTo-v0")
    first, again, other = (run_episode(env, RandomPolicy(env.action_space), seed=seed).poses_m for seed in (4, 4, 5))
    assert first.tolist() == again.tolist()
    assert first[0].tolist() != other[0].tolist()


def test_parallel_environment_repeats_with_its_seed() -> None:
    env: Any = parallel_env(robots=2)
    found = [env.reset(seed=seed)[0]["robot_2"]["goal"].tolist() for seed in (1, 1, 2)]
    assert found[0] == found[1] != found[2]


def test_observations_are_in_metres_and_radians() -> None:
    env = in_room()
    start, goal = (0.2, -0.3, pi / 2), (-0.5, 0.4)
    observation, info = env.reset(seed=1, options={"start_m": start, "goal_m": goal})
    assert observation["pose"] == pytest.approx(start, abs=1e-6)
    assert info["pose_m"] == pytest.approx(start)
    # Sonar 0 looks ahead, along y; 4 to the left; readings are rounded to an inch.
    ahead, left = WALL_M + 0.3 - RING_M, WALL_M + 0.2 - RING_M
    assert observation["ranges"][[0, 4]] == pytest.approx([ahead, left], abs=0.5 * 0.0254 + 1e-6)
    # The goal is 0.7 m to the left and 0.7 m ahead.
    assert observation["goal"] == pytest.approx([hypot(0.7, 0.7), pi / 4], abs=1e-6)
    assert observation["velocity"].tolist() == [0.0, 0.0]


def test_action_is_speed_and_turn_rate() -> None:
    env = in_room(period_s=0.5)
    env.reset(seed=1, options={"start_m": (0.0, -0.5, 0.0), "goal_m": (1.0, 1.0)})
    for _ in range(2):
        observation, *_ = env.step(np.array([0.2, 0.4], dtype=np.float32))
    assert observation["time"].tolist() == [1.0]
    # An arc of radius 0.5 m; setup ideal has no ramps. The chord of a period is a little shorter than its arc.
    x, y, heading = 0.5 * sin(0.4), -0.5 + 0.5 * (1.0 - cos(0.4)), 0.4
    assert observation["pose"] == pytest.approx([x, y, heading], abs=1e-5)
    assert observation["velocity"] == pytest.approx([0.5 * 2.0 * sin(0.1) / 0.5, 0.4], abs=1e-5)
    # The turret turns with the steering: sonar 4 still looks to the left. After a second every sonar has fired again.
    for _ in range(2):
        observation, *_ = env.step(STAND)
    to_wall = min((WALL_M - y) / cos(0.4), (WALL_M + x) / sin(0.4))
    assert observation["ranges"][4] == pytest.approx(to_wall - RING_M, abs=0.0254)


def test_scout_drives_the_same_arc_with_its_wheels() -> None:
    env = in_room(model="scout", period_s=1.0)
    env.reset(seed=1, options={"start_m": (0.0, 0.0, 0.0), "goal_m": (1.0, 1.0)})
    observation, *_ = env.step(np.array([0.2, 0.4], dtype=np.float32))
    assert observation["pose"] == pytest.approx([0.5 * sin(0.4), 0.5 * (1.0 - cos(0.4)), 0.4], abs=1e-5)


def test_actions_are_clipped_to_their_bounds() -> None:
    env = in_room(max_speed_m_s=0.1, period_s=1.0)
    env.reset(seed=1, options={"start_m": (0.0, 0.0, 0.0), "goal_m": (1.0, 1.0)})
    observation, *_ = env.step(np.array([5.0, 0.0], dtype=np.float32))
    assert observation["pose"][0] == pytest.approx(0.1, abs=1e-6)


def test_rewards_add_up_to_the_distance_and_success() -> None:
    env = in_room(goal_m=(0.6, 0.0))
    env.reset(seed=1, options={"start_m": (0.0, 0.0, 0.0)})
    rewards, terminated = [], False
    # Ahead at 0.2 m/s until the goal's radius is reached.
    while not terminated:
        _, reward, terminated, truncated, info = env.step(np.array([0.2, 0.0], dtype=np.float32))
        rewards.append(reward)
        assert not truncated
    # It stops within 0.15 m, after steps of 0.04 m.
    assert info["is_success"]
    assert info["pose_m"][0] == pytest.approx(0.48)
    assert sum(rewards) == pytest.approx(0.48 + 1.0)


def test_contact_ends_an_episode_with_a_penalty() -> None:
    env = in_room(goal_m=(-1.0, 0.0), period_s=1.0)
    env.reset(seed=1, options={"start_m": (WALL_M - 0.3, 0.0, 0.0)})
    _, reward, terminated, _, info = env.step(np.array([0.3, 0.0], dtype=np.float32))
    assert terminated
    assert not info["is_success"]
    # -1 for the contact, and the distance to the goal has grown by the path to the wall.
    assert reward == pytest.approx(-1.0 - (0.3 - 9.72 * 0.0254), abs=1e-3)


def test_explore_sees_cells_before_walls_only() -> None:
    env = explore(world=ROOM, setup="ideal")
    observation, _ = env.reset(seed=1, options={"start_m": (0.0, 0.0, 0.0)})
    seen, half = observation["seen"], Explore.CELLS // 2
    # Columns are x: cells up to 1.524 m less a cell are seen ahead, none behind the wall.
    assert seen[half, half + 4] == 1
    assert not seen[:, half + 7 :].any()
    assert not seen[: half - 7].any()
    total = seen.sum()
    observation, reward, *_ = env.step(np.array([0.0, 0.3], dtype=np.float32))
    assert reward == pytest.approx((observation["seen"].sum() - total) * 0.25**2)


def test_beams_begin_at_the_mounts_of_their_sonars() -> None:
    # One sonar is shifted by its mount, one is not.
    ring = replace(nomad_ring(6.0), angles_rad=(pi / 2, 0.0), shifts_in=((2.0, -3.0), (0.0, 0.0)))
    turret, along = 0.4, 10.0
    points = beam_points(ring, np.array([[5.0, 7.0, 0.0, turret]]), np.array([along]))[:, 0, :, 0]
    for sonar, angle in enumerate(ring.angles_rad):
        x, y = ring.mount_in(sonar)
        x, y = x + along * cos(angle), y + along * sin(angle)
        turned = (5.0 + x * cos(turret) - y * sin(turret), 7.0 + x * sin(turret) + y * cos(turret))
        assert points[:, sonar] == pytest.approx(turned)


def test_goals_are_within_reach_and_not_too_near() -> None:
    env = go_to()
    world = env.runner.task.scene.world
    assert world is not None
    for seed in range(20):
        observation, info = env.reset(seed=seed)
        distance, bearing = observation["goal"].tolist()
        x, y, heading = info["pose_m"]
        goal = x + distance * cos(heading + bearing), y + distance * sin(heading + bearing)
        assert distance >= GoTo.MIN_DISTANCE_M
        assert min(world.clearance(*np.array(place) / 0.0254) for place in (goal, (x, y))) > 9.72
    assert atan2(*env.runner.task.marks_in(0)[0][::-1]) == pytest.approx(atan2(goal[1], goal[0]), abs=1e-5)


def test_picture_shows_the_goal() -> None:
    env = in_room(render_mode="rgb_array")
    env.reset(seed=1, options={"start_m": (0.0, 0.0, 0.0), "goal_m": (1.0, 1.0)})
    picture = env.render()
    assert picture is not None
    assert picture.shape == (500, 500, 3)
    assert picture.dtype == np.uint8
    # Green in the upper right quarter, and nowhere else.
    is_green = (np.abs(picture.astype(int) - (0x2E, 0x8B, 0x57)) < 8).all(axis=2)
    rows, columns = np.nonzero(is_green)
    assert len(rows) > 50
    assert rows.max() < 250 < columns.min()
    assert in_room().render() is None


def test_robots_of_a_parallel_environment_meet() -> None:
    corridor = World("corridor", rooms=(Polygon(((-60.0, -14.0), (60.0, -14.0), (60.0, 14.0), (-60.0, 14.0))),))
    env: Any = parallel_env(robots=2, world=corridor, setup="ideal", task=GoTo((9.0, 9.0)))
    env.reset(seed=3)
    x = [pose[0] for pose in env.runner.poses_m()]
    rear, front = ("robot_1", "robot_2") if x[0] < x[1] else ("robot_2", "robot_1")
    env.runner.robots.reset(np.ones(2, dtype=bool), np.array([[x[0] / 0.0254, 0, 0, 0], [x[1] / 0.0254, 0, 0, 0]]), 1)
    ended: dict[str, bool] = {}
    for _ in range(100):
        actions = {agent: STAND if agent == front else np.array([0.3, 0.0]) for agent in env.agents}
        _, rewards, ended, _, _ = env.step(actions)
        if any(ended.values()):
            break
    assert ended[rear]
    assert rewards[rear] < -0.9
    assert rear not in env.agents


@pytest.mark.parametrize(
    ("make", "word"),
    [
        (lambda: go_to(model="n15"), "n150"),
        (lambda: go_to(setup="nois"), "noisy"),
        (lambda: go_to(world=None), "world"),
        (lambda: in_room().reset(options={"gaol_m": (1, 1)}), "goal_m"),
        (lambda: package.RobotVectorEnv(2, GoTo(), autoreset_mode="SameStep"), "NextStep"),
        (lambda: package.RobotVectorEnv(2, GoTo(), address="sim:"), "rendered"),
        (lambda: parallel_env(address="sim:"), "address"),
        (lambda: parallel_env(robots=60, world="several_walls").reset(), "room"),  # type: ignore[attr-defined]
        (lambda: go_to(address="sim:").reset(), "goal"),
    ],
)
def test_mistakes_are_named(make: Any, word: str) -> None:
    with pytest.raises(ValueError, match=word):
        make()


@pytest.mark.long
def test_wall_follower_keeps_its_distance() -> None:
    env = explore(world="thesis_room", setup="ideal")
    done = run_episode(gymnasium.wrappers.TimeLimit(env, 300), WallFollower(), 1, {"start_m": (1.0, 0.3, 0.0)})
    assert done.steps == 300
    assert done.reward > 1.0


@pytest.mark.long
def test_environments_of_gymnasium_need_no_pettingzoo() -> None:
    program = "import sys; sys.modules['pettingzoo'] = None; import nserver_emu.gym as g; print(g.RobotEnv.__name__)"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, "RobotEnv\n"), done.stderr
