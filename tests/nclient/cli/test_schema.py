"""`nomad schema`: the schemas accept the files that the readers accept, and refuse the others."""

from __future__ import annotations

import copy
import json
import re
import textwrap
import tomllib
from collections.abc import Callable, Iterator
from functools import cache
from itertools import chain
from pathlib import Path
from typing import Any

import pytest
from jsonschema import Draft202012Validator

from fuzz.text_files import _MODEL, _SETUP, _STEPS, _WORLD
from localization.navigation.mission_steps import parse_step_list
from nclient.cli.files import file_schema
from nclient.cli.main import main
from nclient.common.files import parse_toml
from nclient.errors import NomadError
from nclient.faults.plan import parse_plan
from nserver_emu.simulation.models import parse_models
from nserver_emu.simulation.noise import parse_setup
from worlds.io import SHIPPED, parse_world

DOCS = Path(__file__).parents[3] / "docs"
READERS: dict[str, Callable[[str], object]] = {
    "world": lambda text: parse_world(text, "f", "f"),
    "setup": lambda text: parse_setup(text, "f", "f"),
    "model": lambda text: parse_models(text, "f"),
    "mission": lambda text: parse_step_list(text, "f"),
    "faults": lambda text: parse_plan(text, "f"),
}


def blocks(page: str) -> list[str]:
    """Return the TOML blocks of a page that are whole files."""
    text = (DOCS / page).read_text(encoding="utf-8")
    return [textwrap.dedent(block) for block in re.findall(r"^ *```toml\n(.*?)```", text, re.DOTALL | re.MULTILINE)]


# All files that the project ships or shows: worlds, fault plans, missions, setups of the docs, and the templates.
FILES: list[tuple[str, str]] = [
    *(("world", path.read_text(encoding="utf-8")) for path in sorted(SHIPPED.glob("*.toml"))),
    *(("faults", path.read_text(encoding="utf-8")) for path in sorted(DOCS.glob("*.toml"))),
    *(("mission", path.read_text(encoding="utf-8")) for path in sorted((DOCS / "missions").glob("*.toml"))),
    *(("mission", text) for text in blocks("missions.md")),
    *(("setup", text) for text in blocks("setups.md")),
    *(("world", text) for text in blocks("files.md")),
    ("setup", ""), ("setup", _SETUP.decode()), ("model", _MODEL.decode()), ("world", _WORLD.decode()),
    ("mission", _STEPS.decode()),
]  # fmt: skip


@cache
def validator(kind: str) -> Draft202012Validator:
    return Draft202012Validator(file_schema(kind))


def is_read(kind: str, text: str) -> str:
    """Return "" if the reader accepts a text, else its error."""
    try:
        READERS[kind](text)
    except NomadError as error:
        return str(error)
    return ""


@pytest.mark.long
@pytest.mark.parametrize("kind", READERS)
def test_schemas_are_printed_and_valid(kind: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["schema", kind]) == 0
    schema = json.loads(capsys.readouterr().out)
    Draft202012Validator.check_schema(schema)
    assert schema == json.loads(json.dumps(file_schema(kind)))
    assert schema["$schema"] == "https://json-schema.org/draft/2020-12/schema"
    assert len(schema["description"]) > 10


def test_an_unknown_kind_is_refused_with_a_suggestion(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["schema", "wrld"])
    assert ended.value.code == 2
    assert "did you mean world?" in capsys.readouterr().err


def test_values_in_units_are_described() -> None:
    start = file_schema("world")["$defs"]["Start"]["properties"]
    assert start["x_cm"]["description"].endswith("in centimetres")
    # 100000 in are 254000 cm.
    assert (start["x_cm"]["maximum"], start["x_in"]["maximum"]) == pytest.approx((254000.0, 100000.0))
    assert file_schema("setup")["$defs"]["Sonar"]["properties"]["sound_in_s"]["description"] == "speed of sound, in/s"


@pytest.mark.parametrize(("kind", "text"), FILES)
def test_files_of_the_project_are_valid(kind: str, text: str) -> None:
    # The oracle of each is the other: the published schema, and the reader that the programs use.
    validator(kind).validate(tomllib.loads(text))
    assert is_read(kind, text) == ""


# Mutated files

# A value of each type and of each boundary that a key could have by mistake.
VALUES: list[Any] = [
    True, "", " ", "word", -1, 0, 1, 0.5, 2.5, 17, 12345678.5, float("inf"), [], [1], ["word"], [[1, 2]], [[1, 2], [3]],
    {}, {"word": 1}, [{}],
]  # fmt: skip
# Keys of other tables, and pairs that exclude each other.
ADDED: list[tuple[str, Any]] = [
    ("word", 1), ("x_m", 1.0), ("points_cm", [[0, 0], [1, 0]]), ("corners_in", [[0, 0], [1, 0], [1, 1]]),
    ("percent", 1), ("first", 2), ("at", [1]), ("at", 1), ("every", 3), ("delay_s", 1.0), ("keep", 1),
    ("change", "bit"), ("to_in", [1, 1]),
    ("heading_deg", 4), ("touching", True), ("finds", 1), ("model", "ray"), ("model", "polaroid"), ("cone_deg", 20),
    ("std_share", 0.5), ("range_std_relative", 0.5), ("way_loss_db_in", 1.0), ("base", "worn"), ("do", "delay"),
    ("do", ["drop", "nak"]), ("do", ["drop", "drop"]), ("radius_in", 3), ("bumpers", 5),
]  # fmt: skip
# JSON Schema cannot express conditions on geometry, on other entries or on sums.
BEYOND_THE_SCHEMA = re.compile(
    "place inside the world|place of start|same point|first corner|cross$|on one line|earlier|whole number from 0 to 0"
    "|model to be made from|unknown key; expected one of name, like|in small letters|jitter_s|together|until_s"
    "|applies to all"
)
"""What needs geometry, other entries or sums of values."""


def tables(value: Any) -> Iterator[Any]:
    """Yield all tables and lists of a file."""
    if isinstance(value, dict | list):
        yield value
        for inner in value.values() if isinstance(value, dict) else value[:2]:
            yield from tables(inner)


def mutants(values: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Yield copies of a file, each with one entry removed, replaced or added."""
    count = len(list(tables(values)))
    for number in range(count):

        def copied(number: int = number) -> tuple[dict[str, Any], Any]:
            mutant = copy.deepcopy(values)
            return mutant, list(tables(mutant))[number]

        _, table = copied()
        for key in list(table) if isinstance(table, dict) else range(min(len(table), 1)):
            # 1. One entry missing.
            mutant, place = copied()
            del place[key]
            yield mutant
            # 2. One entry replaced.
            for value in VALUES:
                mutant, place = copied()
                place[key] = value
                yield mutant
        # 3. One entry added.
        if isinstance(table, dict):
            for key, value in ADDED:
                mutant, place = copied()
                place[key] = value
                yield mutant


SEEDS = {
    "world": [_WORLD.decode() + '[[path]]\nname = "p"\nstart = 0\npoints_in = [[-20, -20], [-30, -20]]\n'],
    "setup": [_SETUP.decode(), '[sonar]\nmodel = "polaroid"\ncone_deg = 20\nway_loss_db_in = 1\n'],
    "model": [_MODEL.decode()],
    "mission": [_STEPS.decode(), (DOCS / "missions" / "home.toml").read_text(encoding="utf-8")],
    "faults": [(DOCS / "faults.toml").read_text(encoding="utf-8")],
}


@pytest.mark.long
@pytest.mark.parametrize("kind", READERS)
def test_schema_and_reader_agree(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    # The reader gets the mutated tables themselves: they need not be written as TOML.
    mutant: dict[str, Any] = {}
    for module in ("worlds.schema.files", "localization.navigation.mission_steps", "nclient.faults.plan"):
        monkeypatch.setattr(f"{module}.parse_toml", lambda *_: copy.deepcopy(mutant))
    refused = 0
    for number, mutant in enumerate(chain.from_iterable(mutants(tomllib.loads(seed)) for seed in SEEDS[kind])):
        error = is_read(kind, f"# {number}")  # a text of its own, as parsed worlds are cached by their text
        is_valid = validator(kind).is_valid(mutant)
        # What the schema accepts, the reader accepts, apart from conditions that no schema expresses.
        if is_valid:
            assert not error or BEYOND_THE_SCHEMA.search(error), mutant
        else:
            # What the schema refuses, the reader refuses.
            assert error, (mutant, next(validator(kind).iter_errors(mutant)).message)
        refused += not is_valid
    # The mutants must reach the refusals: a schema that accepts everything would pass the loop.
    assert refused > 300


def test_toml_and_json_schema_name_the_same_types() -> None:
    # TOML has dates; JSON Schema has no type for them.
    assert parse_toml("x = 2026-01-01", "f", ValueError)["x"]
    assert "2026-01-01" in is_read("world", "name = 2026-01-01")
    assert not validator("world").is_valid(tomllib.loads("name = 2026-01-01"))


@pytest.mark.parametrize("kind", ["faults", "mission", "model", "setup", "world"])
def test_every_table_and_key_is_described(kind: str) -> None:
    tables = file_schema(kind)["$defs"]
    keys = {
        f"{name}.{key}": entry for name, table in tables.items() for key, entry in table.get("properties", {}).items()
    }
    assert [name for name, entry in (tables | keys).items() if not entry.get("description")] == []
