"""The daemon's log: forms, levels, and that a line stays a line."""

from __future__ import annotations

import argparse
import errno
import fcntl
import io
import json
import logging
import socket
import sys
import threading
import warnings
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

import pytest

from nclient import connect
from nclient.common.arguments import Parser
from nserver_emu import cli, logs
from tests.programs.forked import Forked

DOCS = Path(__file__).parents[2] / "docs"


@pytest.fixture(autouse=True)
def _root_logger_restored() -> Iterator[None]:
    root = logging.getLogger()
    level = root.level
    yield
    logging.captureWarnings(False)
    root.handlers.clear()
    root.setLevel(level)


def as_a_process_begins() -> logging.Logger:
    """Without the handlers that pytest has put there for this test."""
    root = logging.getLogger()
    root.handlers.clear()
    return root


def options(*words: str) -> argparse.Namespace:
    parser = Parser()
    logs.add_options(parser)
    found = parser.parse_args(words)
    assert isinstance(found, argparse.Namespace)
    return found


@pytest.mark.parametrize(("words", "level"), [
    ([], logging.WARNING), (["-v"], logging.INFO), (["-vv"], logging.DEBUG), (["-vvv"], logging.DEBUG),
    (["--log-level", "debug"], logging.DEBUG), (["--log-level", "error", "-vv"], logging.ERROR),
    (["--log-level", "info"], logging.INFO),
])
def test_levels(words: list[str], level: int) -> None:
    assert logs.level_of(options(*words)) == level


def test_a_json_line_has_message_and_template(capsys: pytest.CaptureFixture[str]) -> None:
    as_a_process_begins()
    with logs.logging_to_stderr(options("--log-format", "json")):
        logging.getLogger("package").info("hidden")
        logging.getLogger("package").warning("%s: refused:\n%s", "lab", "pr", extra={"robot": 2, "path": Path("x")})
    # One line, although the message has two.
    (line,) = capsys.readouterr().err.splitlines()
    fields = json.loads(line)
    at = datetime.fromisoformat(fields.pop("time"))
    assert abs((datetime.now(UTC) - at).total_seconds()) < 60
    assert fields == {
        "level": "warning", "logger": "package", "message": "lab: refused:\npr", "template": "%s: refused:\n%s",
        "robot": 2, "path": "x",
    }


def test_an_exception_stands_in_its_own_key(capsys: pytest.CaptureFixture[str]) -> None:
    as_a_process_begins()
    with logs.logging_to_stderr(options("--log-format", "json")):
        try:
            raise ValueError("internal error")
        except ValueError:
            logging.getLogger("package").exception("closed")
    (line,) = capsys.readouterr().err.splitlines()
    fields = json.loads(line)
    assert (fields["level"], fields["message"]) == ("error", "closed")
    assert fields["exception"].endswith("ValueError: internal error")


def test_text_lines_and_python_warnings_are_logged(capsys: pytest.CaptureFixture[str]) -> None:
    as_a_process_begins()
    with warnings.catch_warnings(), logs.logging_to_stderr(options()):
        warnings.simplefilter("always")
        warnings.warn("old", stacklevel=1)
    first = capsys.readouterr().err.splitlines()[0]
    assert "WARNING" in first
    assert "UserWarning: old" in first


@pytest.mark.parametrize("form", ["text", "json"])
def test_why_it_could_not_start_is_the_last_line(form: str, capsys: pytest.CaptureFixture[str]) -> None:
    as_a_process_begins()
    assert cli.main(["no_such_world.toml", "--log-format", form]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    if form == "text":
        assert line.startswith("nserver: no_such_world.toml: no such file")
    else:
        fields = json.loads(line)
        assert fields["level"] == "critical"
        assert fields["message"].startswith("nserver: no_such_world.toml: no such file")
        assert fields["template"] == "nserver: %s"


def test_an_embedding_programs_logging_is_left_alone(capsys: pytest.CaptureFixture[str]) -> None:
    own = logging.NullHandler()
    as_a_process_begins().addHandler(own)
    with logs.logging_to_stderr(options("--log-format", "json", "-vv")):
        assert logging.getLogger().handlers == [own]
        logging.getLogger("package").warning("shown")
    assert capsys.readouterr().err == ""


@pytest.mark.long
def test_every_line_of_a_daemon_is_an_object() -> None:
    # --paused without --allow-control makes the daemon log a warning.
    with Forked("nserver", "--port", "0", "--paused", "--log-format", "json", "-v", stderr=True) as daemon:
        with connect(f"nserver://{daemon.stdout.readline().split()[-1]}/1?tm_s=0"):
            pass
        daemon.terminate()
        _, fields = daemon.communicate(timeout=60)
    lines = [json.loads(line) for line in fields.splitlines()]
    assert "paused, and no client can resume: --allow-control lets them" in [line["message"] for line in lines]
    assert {"%s: connected", "%s: closed after %d refused requests"} <= {line["template"] for line in lines}


class Disk(io.StringIO):
    """A file on a disk that is full for a while."""

    full = False

    def write(self, text: str) -> int:
        if self.full:
            raise OSError(errno.ENOSPC, "No space left on device")
        return super().write(text)


def test_lost_log_lines_are_counted_and_reported(capsys: pytest.CaptureFixture[str]) -> None:
    disk = Disk()
    handler = logs.LossCountingHandler(disk)
    handler.setFormatter(logging.Formatter("%(levelname)s %(message)s"))
    as_a_process_begins().addHandler(handler)
    room = logging.getLogger("package")
    for number in range(6):
        # The disk is full for three of six lines.
        disk.full = number in (1, 2, 3)
        room.warning("line %d", number)
    assert disk.getvalue().splitlines() == [
        "WARNING line 0", "WARNING 3 lines of this log were lost: it could not be written", "WARNING line 4",
        "WARNING line 5",
    ]
    assert capsys.readouterr().err == ""


class Unread(io.StringIO):
    """A pipe that is full and that nothing reads."""

    def __init__(self) -> None:
        super().__init__()
        self.is_read = threading.Event()

    def write(self, text: str) -> int:
        self.is_read.wait()
        return super().write(text)


def test_unread_stderr_blocks_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    pipe = Unread()
    monkeypatch.setattr(sys, "stderr", pipe)
    monkeypatch.setattr(logs, "STOP_S", 0.1)
    as_a_process_begins()
    with logs.logging_to_stderr(options()):
        # More lines than the queue holds; the writer's thread waits in the first one.
        for number in range(logs.MAX_QUEUED + 102):
            logging.getLogger("package").warning("line %d", number)
    assert pipe.getvalue() == ""
    pipe.is_read.set()


def test_dropped_lines_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(logs, "MAX_QUEUED", 3)
    handler = logs.BoundedQueueHandler(logging.Formatter("%(message)s"))
    as_a_process_begins().addHandler(handler)
    room = logging.getLogger("package")
    for number in range(5):
        room.warning("line %d", number)
    # Two are read, so that there is room for the report and one more line.
    first = handler.lines.get_nowait(), handler.lines.get_nowait()
    room.warning("line 5")
    rest = [handler.lines.get_nowait() for _ in range(handler.lines.qsize())]
    assert [record.msg for record in (*first, *rest) if record] == [
        "line 0", "line 1", "line 2", "2 lines of this log were lost: nothing read them in time", "line 5"
    ]


def test_repeated_lines_are_counted_per_address() -> None:
    now_s = 0.0
    limiter = logs.RepeatLimiter(lambda: now_s)

    def written(address: str, template: str) -> int:
        record = logging.makeLogRecord({"msg": template, "address": address})
        return sum(limiter(record) for _ in range(1000))

    assert written("10.0.0.1", "%s: refused: %s") == logs.MAX_REPEATS
    assert written("10.0.0.1", "%s: closed: %s") == logs.MAX_REPEATS
    assert written("10.0.0.2", "%s: refused: %s") == logs.MAX_REPEATS
    assert limiter.summaries() == []
    now_s = logs.REPEAT_INTERVAL_S
    # 1000 of each kind, of which MAX_REPEATS = 10 were written.
    assert [record.getMessage() for record in limiter.summaries()] == [
        "10.0.0.1: 990 more lines in 60 s like '%s: refused: %s'",
        "10.0.0.1: 990 more lines in 60 s like '%s: closed: %s'",
        "10.0.0.2: 990 more lines in 60 s like '%s: refused: %s'",
    ]
    assert written("10.0.0.1", "%s: refused: %s") == logs.MAX_REPEATS
    assert all(limiter(logging.makeLogRecord({"msg": "without an address"})) for _ in range(1000))


def test_many_addresses_share_one_count() -> None:
    limiter = logs.RepeatLimiter()
    records = [logging.makeLogRecord({"msg": "bad", "address": f"{n}"}) for n in range(10 * logs.MAX_KINDS)]
    # Beyond MAX_KINDS addresses the rest share one allowance.
    assert sum(map(limiter, records)) == logs.MAX_KINDS + logs.MAX_REPEATS


@pytest.mark.long
def test_a_daemon_with_unread_stderr_serves_and_ends() -> None:
    """Its log is longer than a pipe holds."""
    with Forked("nserver", "--port", "0", "-vv", stderr=True) as daemon:
        assert daemon.stderr is not None
        # The smallest pipe: one page.
        fcntl.fcntl(daemon.stderr.fileno(), fcntl.F_SETPIPE_SZ, 4096)
        host, _, port = daemon.stdout.readline().split()[-1].partition(":")
        for _ in range(300):
            with socket.create_connection((host, int(port)), timeout=20) as bad:
                bad.sendall(bytes(range(100)))
        with connect(f"nserver://{host}:{port}/1?tm_s=0") as robot:
            robot.refresh()
        daemon.terminate()
        assert daemon.wait(timeout=30) == 0


def test_a_fault_in_what_is_logged_is_shown(capsys: pytest.CaptureFixture[str]) -> None:
    as_a_process_begins().addHandler(logs.LossCountingHandler(Disk()))
    logging.getLogger("package").warning("%d", "no number")
    assert "Logging error" in capsys.readouterr().err


def test_unwritable_stdout_is_logged(
    capfd: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    with open("/dev/full", "w") as full:  # noqa: PTH123 - a device, by its name
        monkeypatch.setattr("sys.stdout", full)
        logs.print_line("listening here")
        logs.print_line("listening there")
    assert caplog.messages == [
        "stdout cannot be written: No space left on device; the daemon goes on; the line was: listening here"
    ]
    assert capfd.readouterr().out == ""


def test_a_level_that_there_is_not(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        cli.main(["--log-level", "warn"])
    assert "no 'warn'; there are debug, info, warning, error; did you mean warning?" in capsys.readouterr().err


def test_the_page_has_every_level_and_key() -> None:
    page = (DOCS / "logs.md").read_text()
    record = logging.LogRecord("package", logging.INFO, "", 0, "shown", None, None)
    keys = json.loads(logs.JsonFormatter().format(record))
    assert all(f"`{key}`" in page for key in (*keys, "exception"))
    assert all(f"| {level} |" in page for level in (*logs.LEVELS, "critical"))
