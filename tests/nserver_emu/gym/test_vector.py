"""The vector environment, in plain Python: the same robots as single environments, and the rules of autoreset."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest

import nserver_emu.gym  # noqa: F401  registers

pytestmark = pytest.mark.usefixtures("plain_batch")
AHEAD = {"start_m": (0.5, 0.5, 0.3), "goal_m": (1.5, 1.0)}


def make(count: int, name: str = "GoTo", **options: Any) -> Any:
    return gymnasium.make_vec(f"Nomad/{name}-v0", num_envs=count, **options)


@pytest.mark.long
@pytest.mark.parametrize("name", ["GoTo", "Explore"])
def test_first_robot_is_that_of_a_single_environment(name: str) -> None:
    options = {"start_m": AHEAD["start_m"], **({"goal_m": AHEAD["goal_m"]} if name == "GoTo" else {})}
    many, one = make(2, name, world="thesis_room"), gymnasium.make(f"Nomad/{name}-v0", world="thesis_room")
    (rows, _), (single, _) = many.reset(seed=5, options=options), one.reset(seed=5, options=options)
    assert rows in many.observation_space
    rng = np.random.default_rng(3)
    for _ in range(12):
        for key, value in single.items():
            assert rows[key][0] == pytest.approx(value, abs=1e-6), key
        # The second robot has noise of its own.
        action = rng.uniform([0.0, -0.5], [0.3, 0.5]).astype(np.float32)
        rows, rewards, ended, cut, info = many.step(np.stack((action, action)))
        single, reward, terminated, truncated, single_info = one.step(action)
        assert rewards[0] == pytest.approx(reward, abs=1e-6)
        assert (ended[0], cut[0]) == (terminated, truncated)
        assert info["pose_m"][0] == pytest.approx(single_info["pose_m"], abs=1e-9)
    assert np.abs(info["pose_m"][0] - info["pose_m"][1]).max() > 1e-4


def drive_to_the_end(env: Any) -> Any:
    """Drive ahead until the first robot touches a wall; the second stands. Return the result of that step."""
    for _ in range(100):
        found = env.step(np.array([[0.3, 0.0], [0.0, 0.0]], dtype=np.float32))
        if found[2][0]:
            return found
    raise AssertionError("the robot met no wall")


def test_next_step_resets_a_robot_whose_episode_ended() -> None:
    env = make(2)
    assert env.metadata["autoreset_mode"] is gymnasium.vector.AutoresetMode.NEXT_STEP
    env.reset(seed=1)
    rows, rewards, ended, _, _ = drive_to_the_end(env)
    assert ended.tolist() == [True, False]
    assert rewards[0] < -0.9
    time_s = rows["time"][1, 0]
    # Robot 1 begins anew in this step, whatever its action; robot 2 continues.
    rows, rewards, ended, cut, _ = env.step(np.full((2, 2), 0.3, dtype=np.float32))
    assert rows["time"][:, 0].tolist() == pytest.approx([0.0, time_s + 0.2])
    assert rewards[0] == 0.0
    assert not (ended | cut).any()
    rows, *_ = env.step(np.zeros((2, 2), dtype=np.float32))
    assert rows["time"][0, 0] == pytest.approx(0.2)


def test_disabled_autoreset_leaves_the_reset_to_the_caller() -> None:
    env = make(2, autoreset_mode="Disabled")
    env.reset(seed=1)
    rows, _, ended, _, _ = drive_to_the_end(env)
    before = rows["pose"][1].tolist()
    rows, _ = env.reset(options={"reset_mask": ended})
    assert rows["time"][0, 0] == 0.0 < rows["time"][1, 0]
    assert rows["pose"][1].tolist() == before


def test_episodes_are_cut_at_their_time_limit() -> None:
    env = make(2, max_episode_steps=3)
    env.reset(seed=1)
    cuts = [env.step(np.zeros((2, 2), dtype=np.float32))[3].tolist() for _ in range(5)]
    # The fourth step is the reset.
    assert cuts == [[False] * 2] * 2 + [[True] * 2] + [[False] * 2] * 2


def test_seed_of_the_vector_repeats() -> None:
    env = make(3)
    first, again, other = (env.reset(seed=seed)[0] for seed in (2, 2, 3))
    assert all((first[key] == again[key]).all() for key in first)
    assert (first["goal"] != other["goal"]).any()
