"""Generate the table of docs/commands.md: the effect of each command on each model, by calling the emulator.

Each command is called once, with plain arguments, on a robot that stands in free space.
"""

from __future__ import annotations

from collections.abc import Iterator
from enum import StrEnum
from typing import Any, Final

from nclient.protocol.commands import ALL, COMMANDS, Call, Command
from nclient.protocol.replies import Reply
from nclient.protocol.types import EVERYTHING, get_model, tcp_wire_state
from nserver_emu.server.handlers.graphics import REFRESHERS
from nserver_emu.server.handlers.table import Emulator
from nserver_emu.server.server_state import Allowed
from nserver_emu.server.session import NOT_AVAILABLE, REFUSED, ConnectionContext
from nserver_emu.simulation.models import MODELS
from nserver_emu.simulation.noise import IDEAL
from nserver_emu.simulation.simulation import Simulation
from worlds.io import load_world

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
"""Arguments of commands for which zeros are invalid."""

class Support(StrEnum):
    """The reply to a command on a model."""

    SUPPORTED = "yes"
    NO_EFFECT = "no effect"
    LACKING = "error 4"
    IF_ALLOWED = "if allowed"
    NOT_OVER_TCP = "—"
    UNEXPECTED = "?"


def examples(row: Command) -> tuple[Any, ...]:
    """Return valid arguments for a command."""
    return _EXAMPLES.get(row.name, (0,) * len(row.arguments))


def support(row: Command, model: str, emulator: Emulator | None = None) -> Support:
    """Return what the emulator does for this command on a robot of this model, in the ideal setup."""
    if row.tcp_type is None:
        return Support.NOT_OVER_TCP
    asked = emulator or _emulator(model, Allowed())
    context = ConnectionContext(tcp_wire_state(get_model(model)), robot_id=1)
    answer = asked.answer(Call(row.name, examples(row)), context)
    if not isinstance(answer, Reply) or answer.kind != "error":
        idle = row.name in REFRESHERS or (row.name == "ac" and not _ramps(asked))
        return Support.NO_EFFECT if idle else Support.SUPPORTED
    if answer.values[0] == REFUSED and emulator is None:
        allowed = support(row, model, _emulator(model, Allowed(quit=True, control=True)))
        return Support.IF_ALLOWED if allowed is Support.SUPPORTED else Support.UNEXPECTED
    return Support.LACKING if answer.values[0] == NOT_AVAILABLE else Support.UNEXPECTED


def rows() -> Iterator[str]:
    """Yield the lines of the table."""
    yield "| command | Robot | type | N150 | N200 | Scout | serial line | effect |"
    yield "|---|---|---|---|---|---|---|---|"
    for row in COMMANDS:
        cells = [support(row, model).value for model in MODEL_NAMES]
        line = "all" if row.line_models == ALL else ", ".join(sorted(name.title() for name in row.line_models))
        line = "—" if row.line_type is None else line
        number = "—" if row.tcp_type is None else str(row.tcp_type)
        yield f"| `{row.name}` | `{row.method}` | {number} | {' | '.join(cells)} | {line} | {row.summary} |"


def blocks() -> dict[str, Iterator[str]]:
    """Return the table of the page."""
    return {"commands": rows()}


def _emulator(model: str, allowed: Allowed) -> Emulator:
    """Return an emulator with one robot of this model and the obstacle that the examples use."""
    simulation = Simulation(load_world("thesis_room"))
    simulation.add_robot(1, None, MODELS[model], IDEAL)
    made = Emulator(simulation, allowed=allowed)
    made.answer(Call("add_obstacle", _TRIANGLE), ConnectionContext(robot_id=1))
    return made


def _ramps(emulator: Emulator) -> bool:
    return emulator.simulation.robots[1].setup.ramps
