"""Policies, which are functions of an observation, and episodes that they drive.

A policy does not know what it drives: an environment of a simulation or of a robot at an address, or with a leading
dimension the robots of a vector environment.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final, NamedTuple

import gymnasium
import numpy as np
import numpy.typing as npt

Policy = Callable[[Mapping[str, npt.NDArray[Any]]], npt.NDArray[Any]]
"""An observation in, an action out: speed in m/s and turn rate in rad/s."""


class RandomPolicy:
    """Actions that are drawn uniformly from a space; each is held for some steps.

    Parameters
    ----------
    space
        Action space, of one robot or of many.
    seed
        Of the draws.
    hold
        Steps that an action lasts.
    """

    def __init__(self, space: gymnasium.Space[Any], seed: int = 0, hold: int = 5) -> None:
        self._space, self._hold, self._step = space, hold, 0
        space.seed(seed)
        self._action = space.sample()

    def __call__(self, observation: Mapping[str, npt.NDArray[Any]]) -> npt.NDArray[Any]:
        """Return the action of this step."""
        del observation
        if self._step % self._hold == 0:
            self._action = self._space.sample()
        self._step += 1
        return np.asarray(self._action)


class WallFollower:
    """Follow the wall at the right by the sonars there and ahead; for rings of sixteen."""

    DISTANCE_M: Final = 0.35
    """Of the sonars from the wall."""
    SPEED_M_S: Final = 0.2
    GAIN: Final = 2.0
    """Turn rate per deviation, rad/s per metre."""
    MAX_TURN_RAD_S: Final = 0.5

    def __call__(self, observation: Mapping[str, npt.NDArray[Any]]) -> npt.NDArray[Any]:
        """Return the action; leading dimensions of the observation are those of the action."""
        ranges = observation["ranges"]
        right, ahead = ranges[..., 11:15].min(axis=-1), ranges[..., [15, 0, 1]].min(axis=-1)
        turn = np.clip(self.GAIN * (self.DISTANCE_M - right), -self.MAX_TURN_RAD_S, self.MAX_TURN_RAD_S)
        # A corner: turn left on the spot.
        is_corner = ahead < self.DISTANCE_M + 0.1
        speed = np.where(is_corner, 0.0, self.SPEED_M_S)
        return np.stack((speed, np.where(is_corner, self.MAX_TURN_RAD_S, turn)), axis=-1).astype(np.float32)


class Episode(NamedTuple):
    """Result of an episode: sum of the rewards, steps, whether the task was done, true poses (steps + 1, 3)."""

    reward: float
    steps: int
    is_success: bool
    poses_m: npt.NDArray[np.float64]


def run_episode(
    env: gymnasium.Env[Any, Any], policy: Policy, seed: int | None = None, options: dict[str, Any] | None = None
) -> Episode:
    """Drive an episode of an environment with a policy to its end."""
    observation, info = env.reset(seed=seed, options=options)
    poses, total = [info["pose_m"]], 0.0
    while True:
        observation, reward, terminated, truncated, info = env.step(policy(observation))
        total += float(reward)
        poses.append(info["pose_m"])
        if terminated or truncated:
            return Episode(total, len(poses) - 1, info["is_success"], np.array(poses))
