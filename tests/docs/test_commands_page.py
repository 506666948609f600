"""Compare docs/commands.md with the emulator, row by row, and with known properties of the robots."""

from __future__ import annotations

from pathlib import Path

import pytest

from docs.generate.commands import MODEL_NAMES, Support, support
from nclient.protocol.commands import BY_NAME, COMMANDS, Command

PAGE = Path(__file__).parents[2] / "docs" / "commands.md"
ROWS = {line.split("`")[1]: line for line in PAGE.read_text().splitlines() if line.startswith("| `")}
ARM = ("arm_zr", "arm_ws", "arm_mv")


def cells(name: str) -> dict[str, str]:
    """Return the cells of a command by model."""
    # Cells 4 to 6 of a row are those of the three models.
    found = [cell.strip() for cell in ROWS[name].split("|")]
    return dict(zip(MODEL_NAMES, found[4:7], strict=True))


@pytest.mark.parametrize("row", COMMANDS, ids=lambda row: row.name)
def test_row_is_what_the_emulator_does(row: Command) -> None:
    found = cells(row.name)
    # The oracle is the emulator: each command is executed on each model.
    assert found == {model: support(row, model).value for model in MODEL_NAMES}, "run scripts/reference-pages"
    assert Support.UNEXPECTED not in found.values()


def test_every_command_has_a_row() -> None:
    assert len(ROWS) == len(COMMANDS)


@pytest.mark.parametrize("name", ["quit_server", "sim_control"])
def test_commands_that_need_permission(name: str) -> None:
    assert set(cells(name).values()) == {"if allowed"}


@pytest.mark.parametrize(
    ("names", "models"),
    [
        (ARM, {"n200"}),
        # Commands that need a real robot or the arm have no "yes".
        (("real_robot", "special_request"), set()),
        (("vm", "pr", "pa", "mv", "gs", "get_sn", "get_bp", "add_obstacle", "draw_arc", "zr"),
         {"n150", "n200", "scout"}),
    ],
)  # fmt: skip
def test_commands_by_model(names: tuple[str, ...], models: set[str]) -> None:
    for name in names:
        assert {model for model, cell in cells(name).items() if cell == "yes"} == models


def test_commands_without_effect_or_not_over_tcp() -> None:
    assert set(cells("ac").values()) == {"no effect"}
    assert {cell for name in ROWS if name.startswith("refresh_") for cell in cells(name).values()} == {"no effect"}
    assert set(cells("conf_ser").values()) == {"—"}
    assert BY_NAME["conf_ser"].tcp_type is None
