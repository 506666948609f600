"""docs/commands.md against the emulator, row by row, and against what is known of the robots."""

from __future__ import annotations

from pathlib import Path

import pytest

from nclient.protocol.commands import BY_NAME, COMMANDS, Command
from nserver_emu.server.handlers.command_table import MODEL_NAMES, Support, markdown, rows, support

DOCUMENT = Path(__file__).parents[4] / "docs" / "commands.md"
WRITTEN = {line.split("`")[1]: line for line in DOCUMENT.read_text().splitlines() if line.startswith("| `")}
ARM = ("arm_zr", "arm_ws", "arm_mv")


def cells(name: str) -> dict[str, str]:
    """What the document says of a command, by model."""
    found = [cell.strip() for cell in WRITTEN[name].split("|")]
    return dict(zip(MODEL_NAMES, found[4:7], strict=True))


@pytest.mark.parametrize("row", COMMANDS, ids=lambda row: row.name)
def test_the_document_says_what_the_emulator_does(row: Command) -> None:
    said = cells(row.name)
    assert said == {model: support(row, model).value for model in MODEL_NAMES}, "run scripts/command-table"
    assert Support.UNEXPECTED not in said.values()


def test_the_whole_document_is_what_the_script_writes() -> None:
    assert markdown() == DOCUMENT.read_text(), "run scripts/command-table"
    assert len(WRITTEN) == len(COMMANDS) == len(list(rows()))


@pytest.mark.parametrize("name", ["quit_server", "sim_control"])
def test_what_has_to_be_allowed(name: str) -> None:
    assert set(cells(name).values()) == {"if allowed"}


@pytest.mark.parametrize(
    ("names", "models"),
    [
        (ARM, {"n200"}),
        (("real_robot", "special_request"), set()),
        (("vm", "pr", "pa", "mv", "gs", "get_sn", "get_bp", "add_obstacle", "draw_arc", "zr"),
         {"n150", "n200", "scout"}),
    ],
)  # fmt: skip
def test_who_has_what(names: tuple[str, ...], models: set[str]) -> None:
    for name in names:
        assert {model for model, said in cells(name).items() if said == "yes"} == models


def test_accelerations_have_no_effect_where_the_original_has_none_and_conf_ser_is_not_over_tcp() -> None:
    assert set(cells("ac").values()) == {"no effect"}
    assert {said for name in WRITTEN if name.startswith("refresh_") for said in cells(name).values()} == {"no effect"}
    assert set(cells("conf_ser").values()) == {"—"}
    assert BY_NAME["conf_ser"].tcp_type is None
