"""docs/commands.md: what each command does on each model, asked of the emulator itself, row by row of THE table.

    python -m nserver_emu.server.handlers.command_table > docs/commands.md          (scripts/command-table does that)

Rules: no cell is written by hand. A command is asked once with plain arguments of a robot that stands free.
"""

from __future__ import annotations

from collections.abc import Iterator
from enum import StrEnum
from typing import Any, Final

from nclient.protocol.commands import ALL, COMMANDS, Call, Command
from nclient.protocol.replies import Reply
from nclient.protocol.types import EVERYTHING, model_named
from nclient.protocol.wire_state import tcp_wire_state
from nserver_emu.server.context import Allowed
from nserver_emu.server.handlers.graphics import REFRESHERS
from nserver_emu.server.handlers.table import Emulator
from nserver_emu.server.session import NOT_AVAILABLE, REFUSED, Visit
from nserver_emu.simulation.models import MODELS
from nserver_emu.simulation.noise import IDEAL
from nserver_emu.simulation.simulation import Simulation
from worlds.files import load_world

MODEL_NAMES: Final = ("n150", "n200", "scout")
_TRIANGLE: Final = (3, 600, 600, 700, 600, 600, 700)
_EXAMPLES: Final[dict[str, tuple[Any, ...]]] = {
    "connect_robot": (1, 1),
    "create_robot": (1, 1),
    "ct": EVERYTHING.smask,
    "tk": ("hello",),
    "special_request": (99, 1, 2),
    "motion_check": (0, 0, 0, 1000, 1000),
    "add_obstacle": _TRIANGLE,
    "delete_obstacle": _TRIANGLE,
    "move_obstacle": (*_TRIANGLE, 5, 5),
    "sim_control": (1, 0),
    "conf_sn": (15, *range(16)),
}
"""Arguments where zeros would not do."""

_HEAD: Final = """\
# Commands

What `nserver` answers to each command over TCP, by model of the robot. Made by `scripts/command-table`, which asks
the emulator; a test asks it again, row by row.

- **yes** answered, with its effect
- **no effect** answered and without effect: accelerations in the `ideal` setup, as the original documents, where axes
  jump to their speed (they ramp in the others); having something redrawn, for what there is to see is always as of now
  and nothing is erased (the server counts how often each layer was asked for)
- **error 4** refused: this model does not have it, or nothing stands behind it
- **if allowed** refused with error 5 unless the server was started to allow it (`--allow-control`, `--allow-quit`)
- **—** does not exist over TCP

The column *own line* names the models on whose own serial line the command exists.

The table is of simulated robots. Behind `nserver --real ADDRESS` commands about the robot go to the real one: what its
own line lacks is error 4, `real_robot` and `simulated_robot` switch ([Gateway](gateway.md)).

| command | Robot | type | N150 | N200 | Scout | own line | what it does |
|---|---|---|---|---|---|---|---|
"""


class Support(StrEnum):
    """What a command gets on a model."""

    SUPPORTED = "yes"
    NO_EFFECT = "no effect"
    LACKING = "error 4"
    IF_ALLOWED = "if allowed"
    NOT_OVER_TCP = "—"
    UNEXPECTED = "?"


def examples(row: Command) -> tuple[Any, ...]:
    """Arguments of a call that a robot which has the command takes."""
    return _EXAMPLES.get(row.name, (0,) * len(row.arguments))


def support(row: Command, model: str, emulator: Emulator | None = None) -> Support:
    """What the emulator does at this command with a robot of this model, in its ideal setup."""
    if row.tcp_type is None:
        return Support.NOT_OVER_TCP
    asked = emulator or _emulator(model, Allowed())
    visit = Visit(tcp_wire_state(model_named(model)), robot_id=1)
    answer = asked.answer(Call(row.name, examples(row)), visit)
    if not isinstance(answer, Reply) or answer.kind != "error":
        idle = row.name in REFRESHERS or (row.name == "ac" and not _ramps(asked))
        return Support.NO_EFFECT if idle else Support.SUPPORTED
    if answer.values[0] == REFUSED and emulator is None:
        allowed = support(row, model, _emulator(model, Allowed(quit=True, control=True)))
        return Support.IF_ALLOWED if allowed is Support.SUPPORTED else Support.UNEXPECTED
    return Support.LACKING if answer.values[0] == NOT_AVAILABLE else Support.UNEXPECTED


def rows() -> Iterator[str]:
    """The lines of the table."""
    for row in COMMANDS:
        cells = [support(row, model).value for model in MODEL_NAMES]
        line = "all" if row.line_models == ALL else ", ".join(sorted(name.title() for name in row.line_models))
        line = "—" if row.line_type is None else line
        number = "—" if row.tcp_type is None else str(row.tcp_type)
        yield f"| `{row.name}` | `{row.method}` | {number} | {' | '.join(cells)} | {line} | {row.summary} |"


def markdown() -> str:
    """The whole document."""
    return _HEAD + "".join(f"{row}\n" for row in rows())


def _emulator(model: str, allowed: Allowed) -> Emulator:
    """One robot of this model, free, and the triangle that the examples speak of."""
    simulation = Simulation(load_world("thesis_room"))
    simulation.add_robot(1, None, MODELS[model], IDEAL)
    made = Emulator(simulation, allowed=allowed)
    made.answer(Call("add_obstacle", _TRIANGLE), Visit(robot_id=1))
    return made


def _ramps(emulator: Emulator) -> bool:
    return emulator.simulation.robots[1].setup.ramps


if __name__ == "__main__":
    print(markdown(), end="")
