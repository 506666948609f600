"""Several robots of one daemon, each found by its number."""

from __future__ import annotations

import subprocess
import sys

from nclient.connect import connect


def test_each_robot_is_found_by_its_number() -> None:
    command = [sys.executable, "-m", "nserver_emu", "--port", "0", "--robots", "3"]
    command += ["--robot", "n150", "--robot", "scout", "--start", "0,0", "--start", "60,50,90"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as program:
        try:
            assert program.stdout is not None
            host = program.stdout.readline().split()[-1]
            with connect(f"nserver://{host}/2?model=scout", timeout_s=10) as second:
                second.refresh()
                assert tuple(second.state.raw[34:38]) == (600, 500, 900, 900)
            with connect(f"nserver://{host}/3", timeout_s=10) as third:
                third.refresh()
                assert tuple(third.state.raw[34:36]) != (0, 0)
        finally:
            program.kill()
