"""Environments of Gymnasium: one robot, and thousands on the batch simulation."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from nserver_emu.gym.robots import BoolArray
from nserver_emu.gym.runner import RENDER_FPS, RunnerOptions, TaskRunner
from nserver_emu.gym.tasks import Explore, GoTo, Observation, Task

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

    def __init__(
        self,
        num_envs: int,
        task: Task,
        *,
        max_episode_steps: int | None = None,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        render_mode: str | None = None,
        threads: int | None = None,
        **options: Any,
    ) -> None:
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
        return {
            "is_success": is_success, "_is_success": of_all, "pose_m": self.runner.poses_m(), "_pose_m": of_all,
        }  # fmt: skip


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
