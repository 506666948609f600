"""What the owner of a simulation may change in it while it runs, besides its time: noise, world. Pure.

    noise    {"sensors": NAME, "motion": NAME, "robot": number}    what is left out stays; no robot: all of them
    world    {"text": TOML, "file": what errors call it}           all of it: rooms, walls, obstacles, starts, paths
    shown    true                                                  its text was told: that text is that very world

Rules: nothing changes unless all of it can. What was changed is on the recording, so that a replay changes it too.
Raises ControlError or WorldFileError, with what would be right.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import PurePath
from typing import Any, Final

from nclient.errors import ControlError, StartError
from nclient.suggesting import did_you_mean
from nserver_emu.server.stage.stage import Stage
from nserver_emu.simulation.robot import SimulatedRobot
from nserver_emu.simulation.setup_parts import PARTS, part_choices, part_name, with_part
from worlds.files import parse_world
from worlds.world import World
from worlds.writing import world_text

Said = dict[str, Any]
ROBOT: Final = "robot"
MOST_SHOWN: Final = 200
"""Worlds that can be put back to the bit; as many steps as a page can take back."""
NOISE_WANTED: Final = "noise: such as sensors=measured motion=ideal robot=1"


def noise_of(robot: SimulatedRobot) -> dict[str, str]:
    """By part, the name of the noise in force."""
    return {part: part_name(part, robot.setup, robot.model, robot.began_as) for part in PARTS}


def noise_choices(robot: SimulatedRobot) -> dict[str, list[str]]:
    """By part, the names there are."""
    return {part: list(part_choices(part, robot.model, robot.began_as)) for part in PARTS}


def switch_noise(stage: Stage, wanted: Mapping[str, Any]) -> dict[str, dict[str, str]]:
    """Switch noise; what is in force then, by robot."""
    if unknown := [name for name in wanted if name not in (*PARTS, ROBOT)]:
        raise ControlError(f"{NOISE_WANTED}, not {unknown[0]!r}")
    if not any(part in wanted for part in PARTS):
        raise ControlError(f"{NOISE_WANTED}; {' and '.join(PARTS)} were both left out")
    robots = stage.simulation.robots
    chosen = list(robots) if wanted.get(ROBOT) is None else [_robot_number(stage, wanted[ROBOT])]
    for robot, setup in [(robots[number], _setup(robots[number], wanted)) for number in chosen]:
        robot.err_as(setup)
    stage.look_anew()
    return {str(number): noise_of(robots[number]) for number in chosen}


def noise_words(text: str) -> dict[str, Any]:
    """The same as a dictionary from words KEY=VALUE."""
    pairs = [word.partition("=") for word in text.split()]
    if not pairs or not all(middle and value for _, middle, value in pairs):
        raise ControlError(f"{NOISE_WANTED}, not {text!r}")
    return {key: int(value) if key == ROBOT and value.isdecimal() else value for key, _, value in pairs}


def put_world(stage: Stage, text: str, file: str) -> World:
    """Put another world in place of the one there; robots stay where they are, which must be free."""
    shown = stage.shown.get(text)
    world = parse_world(text, file, PurePath(file).stem) if shown is None else shown
    for number, robot in stage.simulation.robots.items():
        x, y, radius_in = robot.disc
        try:
            world.require_free(x, y, radius_in)
        except StartError as error:
            raise ControlError(f"{file}: robot {number} stands where there is no room for it: {error}") from None
    stage.simulation.change_world(world)
    stage.look_anew()
    return world


def show_world(stage: Stage) -> str:
    """The world as the text of a file. Put back in time (put_world), that text is this very world again, to the bit,
    with what a file could not say: starts and paths on which something stands."""
    world = stage.simulation.world
    text = world_text(world)
    stage.shown.pop(text, None)
    stage.shown[text] = world
    while len(stage.shown) > MOST_SHOWN:
        del stage.shown[next(iter(stage.shown))]
    return text


def _robot_number(stage: Stage, wanted: object) -> int:
    if not isinstance(wanted, int) or wanted not in stage.simulation.robots:
        raise ControlError(f"noise: no robot {wanted}; there are {', '.join(map(str, stage.simulation.robots))}")
    return wanted


def _setup(robot: SimulatedRobot, wanted: Mapping[str, Any]) -> Any:
    setup = robot.setup
    for part in PARTS:
        if part not in wanted:
            continue
        choices, name = part_choices(part, robot.model, robot.began_as), wanted[part]
        if not isinstance(name, str) or name not in choices:
            near = did_you_mean(str(name), choices)
            raise ControlError(f"noise: {part} is one of {', '.join(choices)}, not {name}{near}")
        setup = with_part(setup, part, choices[name])
    return setup
