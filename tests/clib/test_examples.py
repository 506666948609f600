"""The C programs in examples/ run on a server whose time advances with their requests."""

from __future__ import annotations

import os
import re
import subprocess

from tests.clib.clib_build import PLAIN, ROOT, TIMEOUT_S, BuildCache, run_nserver

C_PRINTS = {
    "wander.c": r"\d+ of 300 steps were turns, at -?\d+, -?\d+ tenths",
    # A mean distance to the wall of 16.0 to 26.9 in.
    "wall_follower.c": r"\d\d\d steps along walls, (1[6-9]|2[0-6])\.\d in away",
}


def test_c_examples_run(builds: BuildCache) -> None:
    with run_nserver("several_walls", "--lockstep", "0.1", "--start", "20,20,0,0") as port:
        for name, prints in C_PRINTS.items():
            variables = os.environ | {"NOMAD_ROBOT": f"nserver://127.0.0.1:{port}/1"}
            program = builds.program(ROOT / "examples" / name, PLAIN)
            done = subprocess.run([str(program)], env=variables, capture_output=True, text=True, timeout=TIMEOUT_S,
                                  check=False)  # fmt: skip
            assert done.returncode == 0, done.stderr
            assert re.search(prints, done.stdout), done.stdout
