"""A robot controller on a simulated robot in this process: time passes with requests only."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from typing import Any

import pytest

from localization.filters.base import LocalizationConfig
from localization.filters.belief import independent
from localization.navigation.pilot import RobotController
from nclient import connect
from worlds.io import load_world
from worlds.robots import BODIES

MakeController = Callable[..., RobotController]


@pytest.fixture
def controller_at() -> Iterator[MakeController]:
    """Yield a factory: `controller_at("thesis_room", "0,0,0,0", setup="noisy", method="finder")`; all are closed."""
    with ExitStack() as closing:

        def make(world: str, start: str = "0,0,0,0", *, method: str = "ekf", **options: Any) -> RobotController:
            # Defaults: seed 1 and 50 ms per request, unless the test gives others.
            words = {"start": start, "seed": 1, "step_s": 0.05, **options}
            query = "&".join(f"{key}={value}" for key, value in words.items())
            robot = closing.enter_context(connect(f"sim:{world}?{query}"))
            state = robot.refresh()
            # The start is known to 0.1 in and 0.01 rad.
            belief = independent([state.x_in, state.y_in, state.steering_rad], (0.1, 0.1, 0.01))
            body = BODIES[str(options.get("robot", "n150"))]
            config = LocalizationConfig(load_world(world).walls, body)
            return closing.enter_context(RobotController(robot, config, body, belief, _idle, method, 10.0))

        yield make


def _idle(_: float) -> None:
    """The rest of a period passes with the next question."""
