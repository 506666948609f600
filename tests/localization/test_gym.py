"""The environment with a filter, the policy that drives on an estimate, and the scores of policies."""

from __future__ import annotations

import json
import math

import gymnasium
import numpy as np
import pytest

from localization.experiments import __main__
from localization.gym import RIGHT_REWARD, Localize, PilotPolicy, localize
from nserver_emu.gym import WallFollower, run_episode


@pytest.mark.long
def test_reward_is_the_information_that_was_gained() -> None:
    env = localize()
    observation, _ = env.reset(seed=2)
    task = env.runner.task
    assert isinstance(task, Localize)
    before = task._estimates[0].belief.cov[:3, :3]
    total, terminated = 0.0, False
    policy = WallFollower()
    for _ in range(300):
        observation, reward, terminated, _, info = env.step(policy(observation))
        total += reward
        if terminated:
            break
    after = task._estimates[0].belief.cov[:3, :3]
    assert info["is_success"]
    # The entropy of a normal distribution: half the logarithm of the determinant, and a constant.
    # The entropies' difference: the constants cancel.
    gained = 0.5 * math.log(np.linalg.det(before) / np.linalg.det(after))
    assert total == pytest.approx(gained + RIGHT_REWARD)
    assert (observation["std"] <= np.array([0.02, 0.02, 0.015], dtype=np.float32)).all()
    assert np.hypot(*(observation["estimate"] - info["pose_m"])[:2]) < 0.1


def test_a_certain_estimate_elsewhere_is_a_failure() -> None:
    env = localize()
    env.reset(seed=2)
    task = env.runner.task
    assert isinstance(task, Localize)
    # With any covariance that is certain, this filter's error is far outside of it.
    task._certain_std = np.full(3, 1e3)
    task._information = np.zeros(1)
    # 500 in off, while the filter claims to be certain.
    task._estimates[0].belief.mean[:2] += 500.0
    score = task.score(env.runner.robots.sense())
    assert (score.is_success.tolist(), score.is_failed.tolist()) == ([False], [True])


def test_filter_needs_a_map() -> None:
    with pytest.raises(ValueError, match="world"):
        localize(world=None, address="sim:thesis_room")


@pytest.mark.long
def test_pilot_reaches_goals_behind_walls() -> None:
    env = gymnasium.make("Nomad/GoTo-v0")
    pilot = PilotPolicy("several_walls")
    found = [run_episode(env, pilot, seed=seed) for seed in range(3)]
    assert all(episode.is_success for episode in found)


def test_scores_are_printed(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["baselines", "--environments", "GoTo", "--episodes"]
    assert __main__.main([*words, "2", "--json"]) == 0
    random, follower, pilot = json.loads(capsys.readouterr().out)
    assert [row["policy"] for row in (random, follower, pilot)] == ["random", "wall follower", "pilot"]
    assert pilot["success"] == 1.0 >= follower["success"]
    assert __main__.main([*words, "1"]) == 0
    assert "Nomad/GoTo-v0" in capsys.readouterr().out
