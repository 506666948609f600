"""The commands and the program of clib/README.md: build, install, compile, run."""

from __future__ import annotations

import os
import re
import subprocess
import tomllib
from pathlib import Path

from tests.clib.clib_build import CLIB, PLAIN, ROOT, BuildCache, run
from tests.nclient.scripted_server import ScriptedServer, by_script, on_socket

README = (CLIB / "README.md").read_text()
MAKEFILE = (CLIB / "Makefile").read_text()
VERSION = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]


def test_readme_commands_exist_in_makefile() -> None:
    (block,) = re.findall(r"```sh\n(.*?)```", README, re.DOTALL)
    for line in block.splitlines():
        words = line.split("#")[0].split()
        assert words[:3] == ["make", "-C", "clib"]
        for word in words[3:]:
            name, is_setting, _ = word.partition("=")
            assert re.search(rf"^ifdef {name}$|^{name} \?=" if is_setting else rf"^{name}:", MAKEFILE, re.MULTILINE)


def test_files_named_in_readme_exist() -> None:
    named = set(re.findall(r"`(src/[\w.]+)`", README))
    assert len(named) > 10
    for file in named:
        assert (CLIB / file).is_file()
    assert (ROOT / "scripts" / "clib-table").is_file()


def test_readme_program_runs_on_installed_library(builds: BuildCache, tmp_path: Path) -> None:
    built, prefix = builds.libraries(PLAIN), tmp_path / "usr"
    options = (f"BUILD={built}", f"CFLAGS={PLAIN.optimization}", f"PREFIX={prefix}")
    # Installed twice, in different folders: the second one must not have paths of the first one.
    run(["make", "-s", "-C", str(CLIB), "install", *options[:2], f"PREFIX={tmp_path / 'another'}"])
    run(["make", "-s", "-C", str(CLIB), "install", *options])
    (text,) = re.findall(r"```c\n(.*?)```", README, re.DOTALL)
    program, server = tmp_path / "program.c", ScriptedServer()
    server.slots = {0: 10, 17: 42, 34: 240, 35: -3}
    with on_socket(by_script(server, 6)) as port:
        program.write_text(text.replace("localhost", "127.0.0.1").replace("7019", str(port)))
        described = (prefix / "lib" / "pkgconfig" / "nclient.pc").read_text()
        # Not the one of the previous installation.
        assert described.startswith(f"prefix={prefix}\nName: nclient\n")
        assert f"\nVersion: {VERSION}\n" in described
        described = described.replace("${prefix}", str(prefix))
        flags = [word for line in described.splitlines() if line.startswith(("Cflags:", "Libs:"))
                 for word in line.split()[1:]]  # fmt: skip
        run(["cc", "-Wall", "-Wextra", "-Werror", str(program), *flags, "-o", str(tmp_path / "program")])
        output = run([str(tmp_path / "program")])
    assert output == "at 240, -3 tenths of an inch; wall ahead 42 in\n"
    assert server.names() == ["zr", "pr", "ws", "get_sn"]
    assert {file.name for file in (prefix / "include").iterdir()} == {"Nclient.h", "nomad.h"}
    assert os.access(prefix / "lib" / "libndirect.a", os.R_OK)
    # `make -q` returns 0 if nothing is left to build.
    assert subprocess.run(["make", "-q", "-C", str(CLIB), *options], check=False).returncode == 0
