"""What the owner of a daemon may do while it runs: a table of commands, and what each does. Pure, but for `save`.

    {"command": "speed", "argument": "10"}   ──>   {"ok": true, "said": {...}}   or   {"ok": false, "error": "..."}

Rules: a JSON object a line, each way. Whoever reaches this is the owner: nothing here asks whether clients may do it.
Whatever is asked wrongly is told with what would be right, and changes nothing.
"""

from __future__ import annotations

import json
import logging
import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Protocol

from nclient.common.hints import suggest, version
from nclient.errors import ControlError, NomadError
from nclient.faults.frames import total
from nclient.faults.plan import parse_plan, plan_text
from nserver_emu.persistence import snapshot
from nserver_emu.server.context import FASTEST, SLOWEST
from nserver_emu.server.handlers.runtime_settings import (
    WANTED,
    change_obstacle,
    noise_of,
    noise_words,
    put_world,
    show_world,
    switch_noise,
)
from nserver_emu.server.handlers.server import LONGEST_STEP_MS
from nserver_emu.server.handlers.table import Emulator
from nserver_emu.server.link import FaultController

log = logging.getLogger(__name__)

MAX_SPEED: Final = "max"
OPERATOR: Final = "nserver ctl"
"""Who holds a robot that was stopped from here."""
Said = dict[str, Any]


class Served(Protocol):
    """A daemon, as far as it is controlled."""

    emulator: Emulator
    faults: FaultController

    def step(self, dt_s: float) -> None:
        """Let simulated time pass."""
        ...

    def paced(self) -> None:
        """The emulator's pace was changed."""
        ...

    def changed(self, what: Mapping[str, Any]) -> None:
        """The simulation was changed so (switches.py), by no client's request."""
        ...

    def hold(self, robot_ids: Iterable[int], by: str) -> None:
        """Stop these robots, and let nobody move them until they are released."""
        ...

    def release(self, robot_ids: Iterable[int]) -> None:
        """They may be moved again."""
        ...

    def lines(self) -> Mapping[str, str]:
        """The lines there are, by name, and where each is reached."""
        ...

    def connected_clients(self) -> list[Said]:
        """Who is connected: name, robot, waiting, refused."""
        ...


@dataclass(frozen=True, slots=True)
class ControlCommand:
    """A row: its name, what its argument is called ("" for none, in brackets where it may be left out), what it is
    for, what it does."""

    name: str
    argument: str
    about: str
    does: Callable[[Served, Any], Said]

    @property
    def wants(self) -> bool:
        """Whether it cannot do without its argument."""
        return bool(self.argument) and not self.argument.startswith("[")


def answer_line(served: Served, line: bytes) -> bytes:
    """The answer to one line of text."""
    try:
        answer = {"ok": True, "said": _done(served, line)}
    except NomadError as error:
        answer = {"ok": False, "error": str(error)}
    return json.dumps(answer).encode() + b"\n"


def _done(served: Served, line: bytes) -> Said:
    try:
        request = json.loads(line)
        name, argument = request["command"], request.get("argument")
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
        raise ControlError('a request is a line such as {"command": "speed", "argument": "10"}') from None
    row = BY_NAME.get(name) if isinstance(name, str) else None
    if row is None:
        raise ControlError(f"no command {name!r}; there are {', '.join(BY_NAME)}{suggest(str(name), BY_NAME)}")
    if row.wants and argument is None:
        raise ControlError(f"{row.name} wants {row.argument}")
    return row.does(served, argument)


def status(served: Served, _: object = None) -> Said:
    """Everything at a glance: time, world, robots as they really stand, lines, clients, faults."""
    emulator, pace = served.emulator, served.emulator.clock
    simulation = emulator.simulation
    return {
        "version": version(), "world": simulation.world.name, "seed": simulation.seed,
        "time_s": round(simulation.time_s, 6), "speed": MAX_SPEED if pace.factor is None else pace.factor,
        "paused": pace.paused, "lockstep_s": pace.lockstep_s,
        "robots": [
            {
                "number": number, "model": robot.model.name, "moving": any(robot.moving), "bumpers": robot.bumpers,
                "x_in": round(robot.actual.x_in, 3), "y_in": round(robot.actual.y_in, 3),
                "steering_deg": round(math.degrees(robot.actual.steering_rad), 2),
                "turret_deg": round(math.degrees(robot.actual.turret_rad), 2), "noise": noise_of(robot),
                "held": None if (hold := emulator.estop.of(number)) is None else hold.told(),
            }
            for number, robot in simulation.robots.items()
        ],
        "lines": dict(served.lines()),
        "connections": served.connected_clients(),
        "faults": {"rules": len(served.faults.plan.rules), "struck": _struck(served.faults)},
    }  # fmt: skip


def _struck(desk: FaultController) -> dict[str, int]:
    together: Counter[str] = Counter()
    for rules in desk.counts().values():
        together.update(total(rules))
    return {kind: count for kind, count in together.items() if count}


def _pause(served: Served, _: object) -> Said:
    served.emulator.clock.paused = True
    return _time(served)


def _resume(served: Served, _: object) -> Said:
    served.emulator.clock.paused = False
    return _time(served)


def _speed(served: Served, argument: object) -> Said:
    if served.emulator.clock.lockstep_s is not None:
        raise ControlError("speed: time moves when a client asks; start nserver without --lockstep to let it run")
    if argument == MAX_SPEED:
        served.emulator.clock.factor = None
    else:
        served.emulator.clock.factor = _number(argument, SLOWEST, FASTEST, f"speed: {MAX_SPEED}, or a number")
    return _time(served)


def _step(served: Served, argument: object) -> Said:
    served.step(_number(argument, 0.0, LONGEST_STEP_MS / 1000, "step: seconds"))
    return _time(served)


def _time(served: Served) -> Said:
    served.emulator.invalidate_state_cache()
    served.paced()
    told = status(served)
    return {key: told[key] for key in ("time_s", "speed", "paused", "lockstep_s")}


def _stop(served: Served, argument: object) -> Said:
    served.hold(_robots(served, argument, "stop"), OPERATOR)
    return {"held": served.emulator.estop.told()}


def _release(served: Served, argument: object) -> Said:
    served.release(_robots(served, argument, "release"))
    return {"held": served.emulator.estop.told()}


def _robots(served: Served, argument: object, command: str) -> list[int]:
    """The robot of that number; every robot where none was said."""
    there = list(served.emulator.simulation.robots)
    if argument is None:
        return there
    number = int(argument) if isinstance(argument, str) and argument.isdecimal() else argument
    if not isinstance(number, int) or number not in there:
        raise ControlError(f"{command}: no robot {argument}; there are {', '.join(map(str, there))}")
    return [number]


def _save(served: Served, argument: object) -> Said:
    path = Path(_text(argument, "save: the name of a file"))
    snapshot.save(served.emulator, path)
    return {"saved": str(path)}


def _show(served: Served, _: object) -> Said:
    return {"plan": plan_text(served.faults.plan)}


def _set(served: Served, argument: object) -> Said:
    """The plan in the argument: its text, and the name of its file for what is wrong with it."""
    wanted = "faults set: the text of a plan, and the name of its file"
    if not isinstance(argument, dict):
        raise ControlError(f'{wanted}: {{"text": ..., "file": ...}}')
    plan = parse_plan(_text(argument.get("text"), wanted), str(argument.get("file", "plan")))
    served.faults.put(plan, served.lines())
    log.info("faults: %d rules in force", len(plan.rules))
    return {"rules": len(plan.rules)}


def _clear(served: Served, _: object) -> Said:
    counts = served.faults.counts()
    served.faults.clear()
    return {"counts": counts}


def _counts(served: Served, _: object) -> Said:
    return {"counts": served.faults.counts()}


def _reset(served: Served, _: object) -> Said:
    counts = served.faults.counts()
    served.faults.reset()
    return {"counts": counts}


def _help(_served: Served, _: object) -> Said:
    return {"commands": {row.name: [row.argument, row.about] for row in COMMANDS}}


def _noise(served: Served, argument: object) -> Said:
    wanted = noise_words(argument) if isinstance(argument, str) else argument
    if not isinstance(wanted, dict):
        raise ControlError(f"noise: a text or an object, not {argument!r}")
    said = {"noise": switch_noise(served.emulator, wanted)}
    served.changed({"noise": wanted})
    return said


def _show_world(served: Served, _: object) -> Said:
    text = show_world(served.emulator)
    served.changed({"shown": True})
    return {"text": text}


def _put_world(served: Served, argument: object) -> Said:
    wanted = "world set: the text of a world file, and its name"
    if not isinstance(argument, dict):
        raise ControlError(f'{wanted}: {{"text": ..., "file": ...}}')
    text, file = _text(argument.get("text"), wanted), _text(argument.get("file", "world.toml"), wanted)
    world = put_world(served.emulator, text, file)
    served.changed({"world": {"text": text, "file": file}})
    return {"world": world.name}


def _obstacle(served: Served, argument: object) -> Said:
    try:
        wanted = json.loads(argument) if isinstance(argument, str) else argument
    except (ValueError, RecursionError):
        wanted = None
    if not isinstance(wanted, dict):
        raise ControlError(f"{WANTED}, not {argument!r:.200}")
    told = change_obstacle(served.emulator, wanted)
    served.changed({"obstacle": wanted})
    return told


def _number(argument: object, least: float, most: float, wanted: str) -> float:
    try:
        value = float(argument) if isinstance(argument, int | float | str) and argument is not True else math.nan
    except (ValueError, OverflowError):
        value = math.nan
    if not least <= value <= most:
        raise ControlError(f"{wanted} from {least:g} to {most:g}, not {argument!r:.60}")
    return value


def _text(argument: object, wanted: str) -> str:
    if not isinstance(argument, str):
        raise ControlError(f"{wanted}, not {argument!r}")
    return argument


COMMANDS: Final = (
    ControlCommand("status", "", "time, robots, lines, clients, faults", status),
    ControlCommand("faults show", "", "the plan of faults in force, as TOML", _show),
    ControlCommand("faults set", "FILE", "put a plan of faults in force, its counts at 0", _set),
    ControlCommand("faults clear", "", "no faults any more", _clear),
    ControlCommand("faults counts", "", "what the plan did so far, by line and rule", _counts),
    ControlCommand("faults reset", "", "the same, and count from 0 again", _reset),
    ControlCommand("noise", "WORDS", "what errs how: 'sensors=measured motion=ideal robot=1'", _noise),
    ControlCommand("world show", "", "the world as it stands, as TOML", _show_world),
    ControlCommand("world set", "WORLD", "put another world in its place; robots stay where they are", _put_world),
    ControlCommand("obstacle", "JSON", "move an obstacle by its corners (by, to), take it away, put one", _obstacle),
    ControlCommand("pause", "", "let simulated time stand", _pause),
    ControlCommand("resume", "", "let it go on", _resume),
    ControlCommand("speed", "X", f"simulated seconds a second, or {MAX_SPEED}", _speed),
    ControlCommand("step", "SECONDS", "let so much simulated time pass at once", _step),
    ControlCommand("stop", "[ROBOT]", "stop a robot, or all, and let nobody move it until it is released", _stop),
    ControlCommand("release", "[ROBOT]", "let clients move it again", _release),
    ControlCommand("save", "FILE", "save the simulation", _save),
    ControlCommand("help", "", "the commands there are", _help),
)
BY_NAME: Final = {row.name: row for row in COMMANDS}
