"""Standard streams that are closed, full or without a reader: one message, and no other file is written to."""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from nclient.common import process

NOMAD = [sys.executable, "-c", "import sys; from nclient.cli.main import main; sys.exit(main())"]
NSERVER = [sys.executable, "-m", "nserver_emu"]
LONG = (
    "import sys\nfrom nclient.common import process as outputs\n"
    "try:\n    print('x' * {size}, flush={flush})\n    sys.stdout.flush()\n"
)
PROGRAM = LONG + "except OSError as error:\n    sys.exit(outputs.handle_broken_pipe(error, 'try'))\n"
FULL = "stdout: cannot be written: No space left on device; make room on that disk, or name a file on another\n"


def in_shell(command: list[str], redirected: str) -> subprocess.CompletedProcess[str]:
    line = f"{shlex.join(command)} {redirected}"
    return subprocess.run(["bash", "-c", line], capture_output=True, text=True, timeout=60, check=False)


@pytest.mark.long
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="the system has no /dev/full")
@pytest.mark.parametrize("flush", [True, False])
# 10 characters stay in the buffer until the end, 100000 are written at once.
@pytest.mark.parametrize("size", [10, 100_000])
def test_full_disk_is_reported_in_one_line(size: int, flush: bool) -> None:
    done = in_shell([sys.executable, "-c", PROGRAM.format(size=size, flush=flush)], ">/dev/full")
    assert (done.returncode, done.stderr) == (1, f"try: {FULL}")


@pytest.mark.long
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="the system has no /dev/full")
@pytest.mark.parametrize(("command", "name"), [
    ([*NOMAD, "state", "sim:thesis_room"], "nomad"), ([*NSERVER, "--list-worlds"], "nserver"),
    ([*NOMAD, "completion", "bash"], "nomad"),
], ids=lambda words: "" if isinstance(words, str) else words[-1])  # fmt: skip
def test_both_commands_report_it(command: list[str], name: str) -> None:
    done = in_shell(command, ">/dev/full")
    assert (done.returncode, done.stderr) == (1, f"{name}: {FULL}")


@pytest.mark.long
def test_a_reader_of_the_list_of_worlds_may_close_early() -> None:
    # `true` reads nothing and ends; the status is that of the first command.
    done = in_shell(NSERVER, "--list-worlds | true; exit ${PIPESTATUS[0]}")
    assert (done.returncode, done.stderr) == (141, "")


@pytest.mark.long
@pytest.mark.parametrize(
    ("closed", "reported"), [(">&-", False), ("2>&-", True), ("<&-", True), (">&- 2>&- <&-", False)]
)
def test_a_command_goes_without_what_is_closed(closed: str, reported: bool) -> None:
    # stdout, stderr, stdin and all three closed, which POSIX allows.
    done = in_shell([*NOMAD, "state", "sim:thesis_room", "pose"], closed)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("pose ") == reported


# Closed descriptors are given to the next file that is opened: output would go into it.
def test_no_file_takes_the_number_of_what_is_closed(tmp_path: Path) -> None:
    program = (
        "import sys\nfrom nclient.common import process as outputs\noutputs.ensure_std_streams()\n"
        f"file = open({str(tmp_path / 'saved')!r}, 'w')\nprint('output')\nprint('error', file=sys.stderr)\n"
        "import os\nos.write(1, b'raw')\nos.write(2, b'raw')\n"
    )
    # All three standard streams are closed.
    done = in_shell([sys.executable, "-c", program], ">&- 2>&- <&-")
    assert done.returncode == 0
    assert (tmp_path / "saved").read_text() == ""


def test_what_is_open_stays_as_it_is() -> None:
    before = sys.stdout, sys.stderr, os.fstat(1), os.fstat(2)
    process.ensure_std_streams()
    assert (sys.stdout, sys.stderr, os.fstat(1), os.fstat(2)) == before


def test_an_error_of_something_else_is_not_stdouts(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(OSError, match="No space left"):
        process.handle_broken_pipe(OSError(28, "No space left on device"), "try")
    assert capsys.readouterr().err == ""
