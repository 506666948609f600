"""An environment of PettingZoo: several robots in one world, which see and touch each other."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium.utils import seeding
from pettingzoo import ParallelEnv

from nserver_emu.gym.tasks import RENDER_FPS, GoTo, Observation, RunnerOptions, Task, TaskRunner

Action = npt.NDArray[np.float32]
Observations = dict[str, Observation]
Flags = dict[str, bool]
Infos = dict[str, dict[str, Any]]


class RobotsParallelEnv(ParallelEnv[str, Observation, Action]):
    """Robots `robot_1` and so on, each with a goal of its own; contacts with each other end episodes, too.

    A robot whose episode has ended stands where it is, in the way of the others.

    Parameters
    ----------
    robots
        Number of robots.
    task
        What is to be done; None: a `GoTo`.
    max_steps
        Steps after which all episodes are truncated.
    render_mode
        "rgb_array" (extra `plot`), or None.
    options
        Fields of `RunnerOptions`, but no address.
    """

    def __init__(self, robots: int = 4, task: Task | None = None, *, max_steps: int = 300,
                 render_mode: str | None = None, world: Any = "arena", **options: Any) -> None:
        if options.get("address") is not None:
            raise ValueError("several robots are not connected to: use an environment for each address")
        self.metadata = {"name": "nomad_v0", "render_modes": ["rgb_array"], "render_fps": RENDER_FPS,
                         "is_parallelizable": True}
        self.runner = TaskRunner(task or GoTo(), RunnerOptions(world=world, **options), robots)
        self.render_mode, self._max_steps, self._steps = render_mode, max_steps, 0
        self.possible_agents = [f"robot_{number}" for number in range(1, robots + 1)]
        self.agents: list[str] = []
        self.observation_spaces = dict.fromkeys(self.possible_agents, self.runner.observation_space)
        self.action_spaces = dict.fromkeys(self.possible_agents, self.runner.action_space)
        self._rng, _ = seeding.np_random()

    def observation_space(self, agent: str) -> Any:
        """Return the space of a robot's observations."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> Any:
        """Return the space of a robot's actions: speed in m/s and turn rate in rad/s."""
        return self.action_spaces[agent]

    def reset(self, seed: int | None = None,
              options: dict[str, Any] | None = None) -> tuple[Observations, Infos]:
        """Begin episodes of all robots; there are no options."""
        del options
        if seed is not None:
            self._rng, _ = seeding.np_random(seed)
        self.agents, self._steps = [*self.possible_agents], 0
        every_robot = np.ones(len(self.agents), dtype=np.bool_)
        observations = self.runner.reset(every_robot, self._rng, None, is_seeded=True)
        return self._of_agents(observations), self._infos(~every_robot)

    def step(self, actions: Mapping[str, Action]) -> tuple[Observations, dict[str, float], Flags, Flags, Infos]:
        """Drive all robots whose episode has not ended for a period."""
        # 1. Robots without an action stand.
        rows, is_driving = np.zeros((len(self.possible_agents), 2)), np.zeros(len(self.possible_agents), dtype=np.bool_)
        for agent in self.agents:
            rows[self._row(agent)], is_driving[self._row(agent)] = actions[agent], True
        found, rewards, terminated, is_success = self.runner.step(rows, is_driving)
        # 2. Results of the robots that were driving; those whose episode ends leave.
        self._steps += 1
        is_over = self._steps >= self._max_steps
        ends = {agent: bool(terminated[self._row(agent)]) for agent in self.agents}
        cuts = {agent: is_over and not ends[agent] for agent in self.agents}
        gained = {agent: float(rewards[self._row(agent)]) for agent in self.agents}
        observations, infos = self._of_agents(found), self._infos(is_success)
        self.agents = [agent for agent in self.agents if not (ends[agent] or cuts[agent])]
        return observations, gained, ends, cuts, infos

    def _row(self, agent: str) -> int:
        return self.possible_agents.index(agent)

    def _of_agents(self, found: Observation) -> Observations:
        return {agent: {name: rows[self._row(agent)] for name, rows in found.items()} for agent in self.agents}

    def _infos(self, is_success: npt.NDArray[np.bool_]) -> Infos:
        poses = self.runner.poses_m()
        return {agent: {"is_success": bool(is_success[self._row(agent)]), "pose_m": poses[self._row(agent)]}
                for agent in self.agents}

    def render(self) -> npt.NDArray[np.uint8] | None:
        """Return a picture of the world and its robots (height, width, 3), in the mode rgb_array."""
        return self.runner.render() if self.render_mode == "rgb_array" else None

    def close(self) -> None:
        """Do nothing."""
