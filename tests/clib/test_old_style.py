"""Programs in the manner of 1998 compile, link and run unchanged, at 64 and 32 bits, with a server and on a line.

Together the programs in old_style/ use every name of the old interface (names.txt). Warnings of the linker are errors.
"""

from __future__ import annotations

import functools
import re
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.clib.clib_build import NARROW, PLAIN, TIMEOUT_S, BuildCache, BuildKind, run, run_nserver
from tests.programs.forked import Forked

OLD_STYLE = Path(__file__).parent / "old_style"
NAMES = [name for name in (OLD_STYLE / "names.txt").read_text().splitlines() if not name.startswith("#")]
# Programs in K&R style with all warnings off, and in ANSI style with all warnings as errors.
KR, ANSI = ("-std=gnu89", "-w"), ("-std=c89", "-D_GNU_SOURCE", "-Wall", "-Wextra", "-Wpedantic", "-Werror")
COMMON = (*KR, "-fcommon")  # of compilers before gcc 10: a variable defined without a value is shared
CPLUSPLUS = ("-std=c++98", "-Wall", "-Wextra", "-Werror")
WIDTHS = pytest.mark.parametrize("width", [PLAIN, NARROW], ids=lambda width: width.name)
NEEDS_BUILD = pytest.mark.usefixtures("skip_unbuildable")


def build(builds: BuildCache, name: str, width: BuildKind, flags: tuple[str, ...], library: str = "nclient") -> str:
    """Build a program in the test's own folder; return its path."""
    source = OLD_STYLE / name
    compiler = "c++" if source.suffix == ".cc" else "cc"
    if compiler == "c++" and not can_build_cplusplus(width):
        pytest.skip(f"no C++ compiler for {width.bits} bits: install g++ or g++-multilib")
    made = builds.libraries(width) / f"old-{source.stem}-{library}{'-common' if '-fcommon' in flags else ''}"
    run([compiler, *flags, *width.flags, "-I", str(OLD_STYLE.parents[2] / "clib" / "include"), str(source),
         "-L", str(made.parent), f"-l{library}", "-Wl,--fatal-warnings", "-o", str(made)])  # fmt: skip
    return str(made)


@functools.cache
def can_build_cplusplus(width: BuildKind) -> bool:
    """Return True if C++ programs with a standard library can be built."""
    if shutil.which("c++") is None:
        return False
    command = ["c++", *width.flags, "-x", "c++", "-", "-o", "/dev/null"]
    return subprocess.run(command, input=b"#include <iostream>\nint main() {}\n", capture_output=True,
                          check=False).returncode == 0  # fmt: skip


def output_of(program: str, *words: str, **variables: str) -> str:
    """Run a program, which must succeed, and return its stdout."""
    done = subprocess.run([program, *words], env={"PATH": "/usr/bin:/bin"} | variables, capture_output=True, text=True,
                          timeout=TIMEOUT_S, check=False)  # fmt: skip
    assert done.returncode == 0, (done.returncode, done.stdout, done.stderr)
    return done.stdout


@pytest.fixture(scope="module")
def n150() -> Iterator[tuple[str, Path]]:
    """Yield the port of a server with two robots, and the serial line of the first."""
    with tempfile.TemporaryDirectory(prefix="nomad", dir="/tmp") as folder:  # SERIAL_PORT holds 39 characters
        link = Path(folder) / "line"
        with run_nserver("--lockstep", "0.05", "--robots", "2", "--serial-link", str(link)) as port:
            yield port, link


@pytest.fixture(scope="module")
def scout(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, Path]]:
    """Yield the port of a server with a Scout, and its serial line."""
    link = tmp_path_factory.mktemp("line") / "scout"
    with run_nserver("--lockstep", "0.05", "--robot", "scout", "--serial-link", str(link)) as port:
        yield port, link


@NEEDS_BUILD
@WIDTHS
@pytest.mark.parametrize("library", ["nclient", "ndirect"])
@pytest.mark.parametrize("name", ["constants.c", "packets.c", "prototypes.c"])
def test_constants_types_and_packets(builds: BuildCache, width: BuildKind, name: str, library: str) -> None:
    assert output_of(build(builds, name, width, ANSI, library)) == f"{name.removesuffix('.c')} ok\n"


@NEEDS_BUILD
@WIDTHS
@pytest.mark.parametrize("flags", [KR, COMMON], ids=["no-common", "common"])
def test_program_with_its_own_variables(
    builds: BuildCache, width: BuildKind, flags: tuple[str, ...], n150: tuple[str, Path]
) -> None:
    port, link = n150
    assert output_of(build(builds, "survey.c", width, flags), "127.0.0.1", port, "1") == "survey ok\n"
    assert output_of(build(builds, "survey.c", width, flags, "ndirect"), str(link)) == "survey ok\n"


@NEEDS_BUILD
@WIDTHS
@pytest.mark.parametrize("flags", [KR, COMMON], ids=["no-common", "common"])
def test_program_without_header(
    builds: BuildCache, width: BuildKind, flags: tuple[str, ...], n150: tuple[str, Path]
) -> None:
    port, link = n150
    program, direct = build(builds, "plain.c", width, flags), build(builds, "plain.c", width, flags, "ndirect")
    assert output_of(program, "127.0.0.1", port) == "plain ok\n"
    assert output_of(program, NOMAD_ROBOT=f"nserver://127.0.0.1:{port}/1") == "plain ok\n"
    assert output_of(direct, str(link)) == "plain ok\n"
    assert output_of(direct, NOMAD_ROBOT=f"serial://{link}?model=n150") == "plain ok\n"


@NEEDS_BUILD
@WIDTHS
def test_scout(builds: BuildCache, width: BuildKind, scout: tuple[str, Path]) -> None:
    port, link = scout
    program, direct = build(builds, "scout.c", width, ANSI), build(builds, "scout.c", width, ANSI, "ndirect")
    assert output_of(program, NOMAD_ROBOT=f"nserver://127.0.0.1:{port}/1") == "turned left\n"
    assert output_of(direct, str(link)) == "turned left\n"
    assert output_of(direct, NOMAD_ROBOT=f"serial://{link}?model=scout") == "turned left\n"


@NEEDS_BUILD
@WIDTHS
def test_class_with_methods_of_the_same_names(builds: BuildCache, width: BuildKind, n150: tuple[str, Path]) -> None:
    port, link = n150
    assert output_of(build(builds, "robot.cc", width, CPLUSPLUS), "127.0.0.1", port, "2") == "robot ok\n"
    direct = build(builds, "robot.cc", width, CPLUSPLUS, "ndirect")
    assert output_of(direct, NOMAD_ROBOT=f"serial://{link}?model=n150") == "robot ok\n"


@pytest.mark.parametrize("standard", ["c++98", "c++17"])
def test_prototypes_and_structures_in_cplusplus(standard: str, tmp_path: Path) -> None:
    if not can_build_cplusplus(PLAIN):
        pytest.skip("no C++ compiler: install g++")
    for name in ("prototypes.c", "packets.c"):
        run(["c++", f"-std={standard}", "-x", "c++", "-Wall", "-Wextra", "-Werror", "-c", str(OLD_STYLE / name),
             "-I", str(OLD_STYLE.parents[2] / "clib" / "include"), "-o", str(tmp_path / "object")])  # fmt: skip


def test_own_header_takes_precedence(builds: BuildCache, tmp_path: Path) -> None:
    (tmp_path / "Nclient.h").write_text("extern long State[45];\nextern int connect_robot(long, ...), gs(void);\n")
    # A header of the program's own, found before the one of the library.
    program, made = tmp_path / "own.c", tmp_path / "own"
    program.write_text('#include "Nclient.h"\nint main(void) { return connect_robot(1) || gs() || State[44] != 111; }')
    run(["cc", "-std=c89", str(program), "-I", str(OLD_STYLE.parents[2] / "clib" / "include"),
         "-L", str(builds.libraries(PLAIN)), "-lnclient", "-Wl,--fatal-warnings", "-o", str(made)])  # fmt: skip
    assert output_of(str(made), NOMAD_ROBOT="nserver://127.0.0.1:1/1") == ""


@NEEDS_BUILD
@WIDTHS
def test_forked_child_leaves_connection_of_parent(
    builds: BuildCache, width: BuildKind, n150: tuple[str, Path]
) -> None:
    assert output_of(build(builds, "twins.c", width, ANSI), "127.0.0.1", n150[0]) == "twins ok\n"


@NEEDS_BUILD
@WIDTHS
def test_two_programs_at_once(builds: BuildCache, width: BuildKind, n150: tuple[str, Path]) -> None:
    port, _ = n150
    program = build(builds, "robot.cc" if can_build_cplusplus(width) else "plain.c", width,
                    CPLUSPLUS if can_build_cplusplus(width) else KR)  # fmt: skip
    # Three programs for each robot at the same time.
    running = [subprocess.Popen([program, "127.0.0.1", port, robot]) for robot in ("1", "2") * 3]
    assert [each.wait(TIMEOUT_S) for each in running] == [0] * 6


@NEEDS_BUILD
@WIDTHS
def test_line_in_variables(builds: BuildCache, width: BuildKind, n150: tuple[str, Path]) -> None:
    assert output_of(build(builds, "opened.c", width, ANSI, "ndirect"), str(n150[1])) == "opened ok\n"


@NEEDS_BUILD
@WIDTHS
def test_loop_ends_when_server_is_gone(builds: BuildCache, width: BuildKind) -> None:
    program = build(builds, "loop.c", width, ANSI)
    with Forked("nserver", "--port", "0") as server:
        port = server.stdout.readline().rpartition(":")[2].strip()
        variables = {"PATH": "/usr/bin:/bin", "NOMAD_ROBOT": f"nserver://127.0.0.1:{port}/1"}
        with subprocess.Popen([program], env=variables, stdout=subprocess.PIPE, text=True) as looping:
            assert looping.stdout is not None
            assert looping.stdout.readline() == "begun\n"
            # The server ends while the program loops on its robot's state.
            server.terminate()
            server.wait(TIMEOUT_S)
            assert looping.communicate(timeout=TIMEOUT_S)[0] == "ended 111\n"


def test_every_name_is_used() -> None:
    # Names in comments are not used.
    texts = [re.sub(r"/\*.*?\*/|//.*?$", "", path.read_text(), flags=re.DOTALL | re.MULTILINE)
             for path in (*OLD_STYLE.glob("*.c"), *OLD_STYLE.glob("*.cc"))]  # fmt: skip
    used = set(re.findall(r"\w+", "\n".join(texts)))
    assert [name for name in NAMES if name not in used] == []


def test_list_of_names_is_complete() -> None:
    assert len(NAMES) == len(set(NAMES)) == 309
