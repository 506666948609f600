"""A user's script: checked with mypy --strict against the installed wheel, and run."""

from __future__ import annotations

import asyncio

from localization.filters.belief import Belief
from nclient import Pose, Robot, RobotState, connect, connect_async
from nclient.capi import State, connect_robot, gs, st
from nserver_emu.simulation.noise import SETUPS
from worlds.io import load_world


def nearest_in(robot: Robot) -> int:
    """Return the shortest sonar reading."""
    state: RobotState = robot.read_sonars()
    return min(state.sonars_in)


async def turned_deg() -> float:
    """Return the steering angle after a turn."""
    async with connect_async("sim:thesis_room") as robot:
        await robot.move(steering_deg=90)
        return (await robot.wait_until_still(10)).steering_deg


def main() -> None:
    with connect("sim:thesis_room?seed=1") as robot:
        robot.place(Pose.from_degrees(10, 5))
        print(f"nearest {nearest_in(robot)} in, {robot.truth().x_in:.0f} in")
    print(f"turned {asyncio.run(turned_deg()):.0f} deg")
    print(load_world("thesis_room").title, sorted(SETUPS), Belief.__name__, connect_robot.__name__, State[0])
    assert callable(gs)
    assert callable(st)


if __name__ == "__main__":
    main()
