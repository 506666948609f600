"""Nclient.h compared with nclient.capi: the same names, arguments and numbers; it compiles in every C standard."""

from __future__ import annotations

import inspect
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from nclient import capi
from nclient.protocol.client_state import ERROR_SLOT, STATE_SIZE
from tests.clib.clib_build import CLIB, PLAIN, BuildCache

INCLUDE = CLIB / "include"
HEADER = (INCLUDE / "Nclient.h").read_text()
NOMAD_H = (INCLUDE / "nomad.h").read_text()
ONLY_C = {
    "get_state", "get_laser", "get_mask", "set_mask", "init_mask", "init_sensors", "set_server_machine_name",
    "set_serv_tcp_port", "add_Obs", "delete_Obs", "move_Obs", "open_serial", "init_send_buffer", "init_receive_buffer",
    "stuff_send_buffer_header", "extract_receive_buffer_header", "stuffchar", "stuff2byteint", "stuff4byteint",
    "stuffuchar", "stuff2byteuint", "stuff4byteuint", "stuffdouble", "extractchar", "extract2byteint",
    "extract4byteint", "extractuchar", "extract2byteuint", "extract4byteuint", "extractdouble",
}  # fmt: skip
"""Functions that Python programs do not need: copies of arrays, bytes of packets, other names."""
ADDITIONS = {"last_error": "nomad_last_error", "sim_truth": "nomad_sim_truth", "sim_control": "nomad_sim_control",
             "held_by": "nomad_held_by"}  # fmt: skip
"""Names of capi that the old library does not have, and their names in nomad.h."""


def declared_functions(text: str) -> dict[str, str]:
    """Return the functions of a header with their parameter lists."""
    # Comments may contain text that looks like a declaration.
    plain = re.sub(r"/\*.*?\*/", "", text, flags=re.DOTALL)
    found = re.findall(r"^extern (?:const |signed |unsigned )?\w+ \*?(\w+)\(([^)]*)\);", plain, re.MULTILINE)
    return {name: " ".join(arguments.split()) for name, arguments in found}


def numbers(text: str) -> dict[str, str]:
    return dict(re.findall(r"^#define (\w+)(?:\([\w, ]*\))? (\S+)", text, re.MULTILINE))


FUNCTIONS, NUMBERS = declared_functions(HEADER), numbers(HEADER)


@pytest.mark.parametrize("name", capi.__all__)
def test_header_has_every_name_of_capi(name: str) -> None:
    if name in ADDITIONS:
        assert ADDITIONS[name] in declared_functions(NOMAD_H)
        assert name not in HEADER
        return
    arrays = set(re.findall(r"^extern \w+ (\w+)\[", HEADER, re.MULTILINE))
    assert name in FUNCTIONS.keys() | NUMBERS.keys() | arrays


@pytest.mark.parametrize("name", sorted(FUNCTIONS.keys() & set(capi.__all__) - {"connect_robot"}))
def test_arguments_equal_capi(name: str) -> None:
    given = [re.sub(r"\[\d*\]", "", argument).split()[-1].lstrip("*") for argument in FUNCTIONS[name].split(",")]
    wanted = list(inspect.signature(getattr(capi, name)).parameters)
    assert [argument for argument in given if argument != "void"] == wanted


def test_capi_has_every_function_of_header() -> None:
    assert FUNCTIONS.keys() - set(capi.__all__) == {"nomad_connect_robot", *ONLY_C}


def test_constants_equal_capi() -> None:
    for name in ("TRUE", "FALSE", "MODEL_N200", "MODEL_N150", "MODEL_SCOUT", "ROTATION_CONSTANT"):
        assert float(NUMBERS[name]) == getattr(capi, name)
    assert len(capi.State) == int(NUMBERS["NUM_STATE"]) == STATE_SIZE
    assert len(capi.Smask) == int(NUMBERS["NUM_MASK"])
    # A count and NUM_LASER readings of two numbers.
    assert len(capi.Laser) == 2 * int(NUMBERS["NUM_LASER"]) + 1
    assert int(NUMBERS["STATE_ERROR"]) == ERROR_SLOT
    for index in range(16):
        assert int(NUMBERS[f"STATE_IR_{index}"]) == int(NUMBERS[f"SMASK_IR_{index + 1}"]) == 1 + index
        assert int(NUMBERS[f"STATE_SONAR_{index}"]) == int(NUMBERS[f"SMASK_SONAR_{index + 1}"]) == 17 + index
    names = ("BUMPER", "CONF_X", "VEL_TRANS", "MOTOR_STATUS", "COMPASS")
    assert [int(NUMBERS[f"STATE_{name}"]) for name in names] == [33, 34, 38, 41, 43]


LANGUAGES = [("c89", "c"), ("gnu89", "c"), ("c99", "c"), ("c11", "c")]
if shutil.which("c++"):
    LANGUAGES.append(("c++11", "c++"))


@pytest.mark.parametrize(("standard", "language"), LANGUAGES)
def test_headers_compile_in_every_standard(standard: str, language: str, tmp_path: Path) -> None:
    program = tmp_path / "program"
    # Included twice: the header must protect itself.
    program.write_text('#include "Nclient.h"\n#include "nomad.h"\n#include "Nclient.h"\n'
                       "int main(void) { return connect_robot(1) && vm(1, RIGHT(3, 4), 0); }\n")  # fmt: skip
    strict = () if standard == "gnu89" else ("-Wpedantic",)
    command = ["cc", f"-std={standard}", "-x", language, "-Wall", "-Wextra", "-Werror", *strict, "-fsyntax-only",
               "-I", str(INCLUDE), str(program)]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("library", ["libnclient.a", "libndirect.a"])
def test_libraries_export_only_header_names(library: str, builds: BuildCache) -> None:
    made = builds.libraries(PLAIN) / library
    listed = subprocess.run(["nm", "-g", "--defined-only", str(made)], capture_output=True, text=True, check=True)
    # Lines without an address are undefined symbols.
    symbols = {line.split()[-1] for line in listed.stdout.splitlines() if len(line.split()) == 3}
    globals_ = set(re.findall(r"^extern (?:char|int|long|double) (\w+)(?:\[.*?\])?;", HEADER, re.MULTILINE))
    assert len(globals_) == 18
    internal = {symbol for symbol in symbols if symbol.startswith("nomad_")}
    assert symbols - internal == FUNCTIONS.keys() - {"nomad_connect_robot"} | globals_
