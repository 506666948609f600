"""`python -m localization.experiments baselines`: scores of simple policies in the environments of Gymnasium.

Episode k of every policy has seed k, so that all of them begin at the same places.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from statistics import mean
from types import MappingProxyType
from typing import Any, Final, NamedTuple

from localization.experiments import execution
from localization.experiments.execution import progress
from nclient.common.arguments import Parser, add_value
from nclient.errors import ExtraMissing, install_command


class Score(NamedTuple):
    """Means over the episodes of a policy in an environment; `cut` is the fraction that the time limit ended."""

    environment: str
    policy: str
    episodes: int
    success: float
    cut: float
    reward: float
    duration_s: float


def _policies() -> Mapping[str, Mapping[str, Callable[[Any], Any]]]:
    """Return the policies of each environment by name: functions of the environment."""
    from localization.gym import PilotPolicy
    from nserver_emu.gym import RandomPolicy, WallFollower

    simple = {"random": lambda env: RandomPolicy(env.action_space), "wall follower": lambda _: WallFollower()}
    pilot = {"pilot": lambda env: PilotPolicy(env.unwrapped.runner.task.scene.world)}
    return MappingProxyType({"GoTo": simple | pilot, "Localize": simple, "Explore": simple})


ENVIRONMENTS: Final = ("GoTo", "Localize", "Explore")


def main(arguments: Sequence[str]) -> None:
    """Run the command. Raises ExtraMissing without Gymnasium."""
    options = _parser().parse_args(arguments)
    try:
        import gymnasium
    except ImportError as error:
        raise ExtraMissing(f"environments need Gymnasium: {install_command('gym')}") from error
    policies, scores = _policies(), []
    total = options.episodes * sum(len(policies[name]) for name in options.environments)
    with progress(total, "baselines", "episodes") as tally:
        for name in options.environments:
            for policy, make in policies[name].items():
                env = gymnasium.make(f"Nomad/{name}-v0")
                scores.append(_score(name, policy, env, make(env), options.episodes))
                tally(sum(score.episodes for score in scores))
    if options.json:
        print(json.dumps([score._asdict() for score in scores]))
    else:
        print(table(scores))


def _score(name: str, policy_name: str, env: Any, policy: Any, count: int) -> Score:
    from nserver_emu.gym import run_episode

    episodes = [run_episode(env, policy, seed=seed) for seed in range(count)]
    period_s, longest = env.unwrapped.runner.options.period_s, env.spec.max_episode_steps
    return Score(
        environment=f"Nomad/{name}-v0",
        policy=policy_name,
        episodes=count,
        success=mean(episode.is_success for episode in episodes),
        cut=mean(episode.steps >= longest and not episode.is_success for episode in episodes),
        reward=mean(episode.reward for episode in episodes),
        duration_s=period_s * mean(episode.steps for episode in episodes),
    )


def table(scores: Sequence[Score]) -> str:
    """Return a text table."""
    lines = [["environment", "policy", "success", "time limit", "reward", "time (s)"]]
    lines += [
        [score.environment, score.policy, f"{score.success:.0%}", f"{score.cut:.0%}", f"{score.reward:.2f}",
         f"{score.duration_s:.0f}"]
        for score in scores
    ]  # fmt: skip
    return execution.text_table(lines)


def _parser() -> Parser:
    parser = execution.parser_of("baselines", "--episodes 20 --environments GoTo",
                                 "Run simple policies in the environments of Gymnasium (extra `gym`) and report how "
                                 "often they succeed, how often the time limit cuts them, their mean reward and their "
                                 "mean duration; other episodes end by a contact or with a wrong estimate.")
    add_value(parser, "--episodes", "N", execution.positive, "episodes of each policy", 20)
    execution.add_choice(parser, "--environments", ENVIRONMENTS, list(ENVIRONMENTS), "environments")
    parser.add_argument("--json", action="store_true", help="print the numbers as JSON")
    return parser
