"""Robots as environments of Gymnasium and PettingZoo (extra `gym`); importing this module registers them.

    import nserver_emu.gym

    gymnasium.make("Nomad/GoTo-v0")                     one robot: of a simulation, or at an address
    gymnasium.make_vec("Nomad/GoTo-v0", num_envs=1000)  thousands, on the batch simulation
    nserver_emu.gym.parallel_env(robots=4)              several in one world, for PettingZoo

robots          what is driven: a batch, robots of one simulation, a connected robot
tasks           what is to be done: observations, rewards, the end; and its runner, for n robots at once
environments    the interfaces of Gymnasium, and policies, which drive them
parallel        the interface of PettingZoo

Observations and actions are in metres, radians and seconds; inside, in inches, as in the simulation.
"""

from nclient.errors import ExtraMissing, install_command

try:
    import gymnasium
except ModuleNotFoundError as missing:
    raise ExtraMissing(f"nserver_emu.gym needs gymnasium: {install_command('gym')}") from missing

from nserver_emu.gym.environments import (
    Episode,
    Policy,
    RandomPolicy,
    RobotEnv,
    RobotVectorEnv,
    WallFollower,
    run_episode,
)
from nserver_emu.gym.tasks import Explore, GoTo, RunnerOptions, Task

__all__ = [
    "Episode", "Explore", "GoTo", "Policy", "RandomPolicy", "RobotEnv", "RobotVectorEnv", "RunnerOptions", "Task",
    "WallFollower", "parallel_env", "run_episode",
]  # fmt: skip


def parallel_env(**options: object) -> object:
    """Return an environment of PettingZoo with several robots; see `parallel.RobotsParallelEnv`."""
    from nserver_emu.gym.parallel import RobotsParallelEnv  # needs PettingZoo, which the other environments do not

    return RobotsParallelEnv(**options)  # type: ignore[arg-type]


# Localize needs a filter, which this package does not import: Gymnasium does, by this name.
for _name, _entry_point, _vector_entry_point, _steps in (
    ("GoTo", "nserver_emu.gym.environments:go_to", "nserver_emu.gym.environments:go_to_vector", 300),
    ("Explore", "nserver_emu.gym.environments:explore", "nserver_emu.gym.environments:explore_vector", 1500),
    ("Localize", "localization.gym:localize", None, 300),
):
    gymnasium.register(id=f"Nomad/{_name}-v0", entry_point=_entry_point, vector_entry_point=_vector_entry_point,
                       max_episode_steps=_steps)
