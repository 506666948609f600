"""docs/from-c.md: every call of C has its row, what stands beside it is so, and both programs arrive."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

from nclient import capi, connect
from nclient.from_c import beside, markdown
from nclient.protocol.commands import BY_NAME

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "from-c.md").read_text()
HEADER = (ROOT / "clib" / "include" / "Nclient.h").read_text()
NAMED = re.findall(r"^\| `(\w+)\(", PAGE, re.MULTILINE)


def test_the_page_is_what_the_script_writes() -> None:
    assert markdown() == PAGE, "run scripts/from-c-page"


def test_every_call_of_the_header_and_of_the_mirror_has_one_row() -> None:
    declared = set(re.findall(r"^extern (?:int|float) (?!nomad_)(\w+)\(", HEADER, re.MULTILINE)) | {"RIGHT", "LEFT"}
    mirrored = {name for name in capi.__all__ if callable(getattr(capi, name))} - {"last_error"}
    assert sorted(NAMED) == sorted(mirrored)
    assert declared - set(NAMED) == set()
    assert len(set(NAMED)) == len(NAMED)
    assert set(beside()) == set(NAMED) - set(BY_NAME)


@pytest.mark.parametrize("name", beside())
def test_what_stands_beside_a_call_is_python(name: str) -> None:
    model = "scout" if re.search("scout|RIGHT|LEFT", name) else "n200"
    address = f"sim:thesis_room?robot={model}"
    with connect(address) as robot:
        robot.position_data(infrareds=True, sonars=True, bumpers=True, laser=model == "n200", compass=model == "n200")
        given: dict[str, Any] = {"robot": robot, "connect": connect, "address": address}
        value = eval(beside()[name], given)
        assert value is not None
        if isinstance(value, list):
            assert len(value) == 16
            assert None not in value
        if hasattr(value, "disconnect"):
            value.disconnect()


@pytest.mark.parametrize(("number", "told"), [(0, "240 0\n"), (1, "24.0 0.0\n")])
def test_both_programs_arrive(
    number: int, told: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(capi, "SERVER_MACHINE_NAME", "")
    exec(compile(re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)[number], "from-c.md", "exec"), {})
    assert capsys.readouterr().out == told
