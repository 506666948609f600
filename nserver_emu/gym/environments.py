"""Environments of Gymnasium: one robot, and thousands on the batch simulation; policies and episodes.

A policy is a function of an observation. It does not know what it drives: an environment of a simulation or of a robot
at an address, or with a leading dimension the robots of a vector environment.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final, NamedTuple

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from nserver_emu.gym.robots import BoolArray
from nserver_emu.gym.tasks import RENDER_FPS, Explore, GoTo, Observation, RunnerOptions, Task, TaskRunner

Action = npt.NDArray[np.float32]
Info = dict[str, Any]

ALL = np.ones(1, dtype=np.bool_)


class RobotEnv(gymnasium.Env[Observation, Action]):
    """A robot with a task.

    A contact ends an episode with reward -1. `info` has `is_success` and the true `pose_m`.

    Parameters
    ----------
    task
        What is to be done.
    render_mode
        "rgb_array" (extra `plot`), or None.
    options
        Fields of `RunnerOptions`.
    """

    def __init__(self, task: Task, *, render_mode: str | None = None, **options: Any) -> None:
        self.metadata = {"render_modes": ["rgb_array"], "render_fps": RENDER_FPS}
        self.runner = TaskRunner(task, RunnerOptions(**options))
        self.render_mode = render_mode
        self.observation_space, self.action_space = self.runner.observation_space, self.runner.action_space

    def reset(self, *, seed: int | None = None, options: Info | None = None) -> tuple[Observation, Info]:
        """Begin an episode; `options` may have start_m (x, y, heading) and goal_m (x, y), metres and radians."""
        super().reset(seed=seed)
        observations = self.runner.reset(ALL, self.np_random, options, is_seeded=True)
        return _first(observations), {"is_success": False, "pose_m": self.runner.poses_m()[0]}

    def step(self, action: Action) -> tuple[Observation, float, bool, bool, Info]:
        """Drive for a period with a speed in m/s and a turn rate in rad/s."""
        found, rewards, terminated, is_success = self.runner.step(np.asarray(action)[np.newaxis])
        info = {"is_success": bool(is_success[0]), "pose_m": self.runner.poses_m()[0]}
        return _first(found), float(rewards[0]), bool(terminated[0]), False, info

    def render(self) -> npt.NDArray[np.uint8] | None:
        """Return a picture of the world and the robot (height, width, 3), in the mode rgb_array."""
        return self.runner.render() if self.render_mode == "rgb_array" else None

    def close(self) -> None:
        """Stop a connected robot."""
        self.runner.robots.close()


def _first(observations: Observation) -> Observation:
    return {name: rows[0] for name, rows in observations.items()}


class RobotVectorEnv(VectorEnv[Observation, Action, npt.NDArray[Any]]):
    """Robots with one task each, on the batch simulation (extra `fast`), which has exact rays and no N200.

    Robot i is the same as that of a `RobotEnv`; it has a world for itself.

    Parameters
    ----------
    num_envs
        Number of robots.
    task
        What is to be done.
    max_episode_steps
        Steps after which an episode is truncated; None: no limit.
    autoreset_mode
        NEXT_STEP: the step after an end resets the robot and has reward 0. DISABLED: the caller resets, with
        `reset(options={"reset_mask": ended})`.
    threads
        Threads that share the robots; None: one per core.
    options
        Fields of `RunnerOptions`, but no address.
    """

    def __init__(self, num_envs: int, task: Task, *, max_episode_steps: int | None = None,
                 autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP, render_mode: str | None = None,
                 threads: int | None = None, **options: Any) -> None:
        self._autoreset_mode = AutoresetMode(autoreset_mode)
        if self._autoreset_mode is AutoresetMode.SAME_STEP:
            raise ValueError("expected the autoreset mode NextStep or Disabled, got SameStep")
        if render_mode is not None or options.get("address") is not None:
            raise ValueError("many robots are neither rendered nor connected to: use gymnasium.make for one")
        self.metadata = {"autoreset_mode": self._autoreset_mode, "render_modes": []}
        self.runner = TaskRunner(task, RunnerOptions(**options), num_envs, is_batch=True, threads=threads)
        self.num_envs, self.render_mode = num_envs, None
        self.single_observation_space = self.runner.observation_space
        self.single_action_space = self.runner.action_space
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._max_steps = max_episode_steps
        self._steps = np.zeros(num_envs, dtype=np.int64)
        self._has_ended = np.zeros(num_envs, dtype=np.bool_)

    def reset(self, *, seed: int | None = None, options: Info | None = None) -> tuple[Observation, Info]:
        """Begin episodes of all robots, or of those of the option `reset_mask`."""
        super().reset(seed=seed)
        given = dict(options or {})
        mask = np.asarray(given.pop("reset_mask", np.ones(self.num_envs)), dtype=np.bool_)
        # Robots that drive on keep their random streams.
        observations = self._begin(mask, given, is_seeded=bool(mask.all()))
        return observations, self._info(np.zeros(self.num_envs, dtype=np.bool_))

    def _begin(self, mask: BoolArray, options: Info | None, *, is_seeded: bool) -> Observation:
        self._steps[mask], self._has_ended[mask] = 0, False
        return self.runner.reset(mask, self.np_random, options, is_seeded=is_seeded)

    def step(self, actions: Action) -> tuple[Observation, npt.NDArray[Any], npt.NDArray[Any], npt.NDArray[Any], Info]:
        """Drive for a period with speeds in m/s and turn rates in rad/s (n, 2)."""
        # 1. Robots whose episode has ended stand, and begin anew below.
        again = self._has_ended.copy() if self._autoreset_mode is AutoresetMode.NEXT_STEP else None
        observations, rewards, terminated, is_success = self.runner.step(actions, None if again is None else ~again)
        self._steps += 1
        # 2. Their step is the reset.
        if again is not None and again.any():
            observations = self._begin(again, None, is_seeded=False)
            rewards[again], terminated[again], is_success[again] = 0.0, False, False
        # 3. Time limit.
        truncated = np.zeros_like(terminated) if self._max_steps is None else self._steps >= self._max_steps
        truncated &= ~terminated
        self._has_ended = terminated | truncated
        return observations, rewards, terminated, truncated, self._info(is_success)

    def _info(self, is_success: BoolArray) -> Info:
        # Gymnasium marks by _NAME which robots have a value.
        of_all = np.ones(self.num_envs, dtype=np.bool_)
        return {"is_success": is_success, "_is_success": of_all, "pose_m": self.runner.poses_m(), "_pose_m": of_all}


# Entry points of the registry. Defaults of worlds suit the task.


def go_to(goal_m: tuple[float, float] | None = None, **options: Any) -> RobotEnv:
    """Return the environment Nomad/GoTo-v0."""
    return RobotEnv(GoTo(goal_m), **options)


def go_to_vector(num_envs: int, goal_m: tuple[float, float] | None = None, **options: Any) -> RobotVectorEnv:
    """Return many of Nomad/GoTo-v0."""
    return RobotVectorEnv(num_envs, GoTo(goal_m), **options)


def explore(world: Any = "flat", **options: Any) -> RobotEnv:
    """Return the environment Nomad/Explore-v0."""
    return RobotEnv(Explore(), world=world, **options)


def explore_vector(num_envs: int, world: Any = "flat", **options: Any) -> RobotVectorEnv:
    """Return many of Nomad/Explore-v0."""
    return RobotVectorEnv(num_envs, Explore(), world=world, **options)


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


def run_episode(env: gymnasium.Env[Any, Any], policy: Policy, seed: int | None = None,
                options: dict[str, Any] | None = None) -> Episode:
    """Drive an episode of an environment with a policy to its end."""
    observation, info = env.reset(seed=seed, options=options)
    poses, total = [info["pose_m"]], 0.0
    while True:
        observation, reward, terminated, truncated, info = env.step(policy(observation))
        total += float(reward)
        poses.append(info["pose_m"])
        if terminated or truncated:
            return Episode(total, len(poses) - 1, info["is_success"], np.array(poses))
