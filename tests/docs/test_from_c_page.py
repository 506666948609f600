"""Check that docs/from-c.md has every call of C, evaluate its examples, and run both of its programs."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

from docs.generate.from_c import examples
from nclient import capi, connect
from nclient.protocol.commands import BY_NAME
from tests.clib.test_header import ONLY_C

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "from-c.md").read_text()
HEADER = (ROOT / "clib" / "include" / "Nclient.h").read_text()
NAMED = re.findall(r"^\| `(\w+)\(", PAGE, re.MULTILINE)



def test_every_call_of_c_and_capi_has_one_row() -> None:
    declared = set(re.findall(r"^extern (?:int|float) (?!nomad_)(\w+)\(", HEADER, re.MULTILINE)) | {"RIGHT", "LEFT"}
    mirrored = {name for name in capi.__all__ if callable(getattr(capi, name))} - {"last_error"}
    assert sorted(NAMED) == sorted(mirrored)
    # Functions without a row are those that only C programs need.
    assert declared - set(NAMED) <= ONLY_C
    assert len(set(NAMED)) == len(NAMED)
    assert set(examples()) == set(NAMED) - set(BY_NAME)


@pytest.mark.parametrize("name", examples())
def test_example_is_valid_python(name: str) -> None:
    # Wheel commands exist on a Scout only, lasers on a N200 only.
    model = "scout" if re.search("scout|RIGHT|LEFT", name) else "n200"
    address = f"sim:thesis_room?robot={model}"
    with connect(address) as robot:
        robot.position_data(infrareds=True, sonars=True, bumpers=True, laser=model == "n200", compass=model == "n200")
        names: dict[str, Any] = {"robot": robot, "connect": connect, "address": address}
        value = eval(examples()[name], names)
        assert value is not None
        if isinstance(value, list):
            assert len(value) == 16
            assert None not in value
        if hasattr(value, "disconnect"):
            value.disconnect()


# The program in the style of C prints tenths, the other one inches.
@pytest.mark.parametrize(("number", "output"), [(0, "240 0\n"), (1, "24.0 0.0\n")])
def test_programs_reach_the_same_position(
    number: int, output: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(capi, "SERVER_MACHINE_NAME", "")
    exec(compile(re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)[number], "from-c.md", "exec"), {})
    assert capsys.readouterr().out == output
