"""Logging of the daemon on stderr: lines of text, or one JSON object per line for log collectors.

    {"time": "2026-11-21T10:27:45.123Z", "level": "warning", "logger": "nserver_emu.server.session",
     "message": "127.0.0.1:4711: refused: ...", "template": "%s: refused: %s ..."}        and "exception" for tracebacks

`template` is the same for all lines of one kind, so that they can be counted; fields passed by `extra=` are added. A
message is always one line.

    log.warning() -> RepeatLimiter -> queue of MAX_QUEUED lines -> thread -> stderr

Nothing on stderr can stop the daemon: a thread of its own writes, so that a reader that does not read (a full pipe)
blocks the thread only, and a full disk loses lines. Lost lines are counted, and the count is logged when lines can be
written again. Of lines about a client (`extra={"address": ...}`) only a few of each kind are written per minute and
address; the rest is counted and reported as one line.
"""

import argparse
import contextlib
import io
import json
import logging
import os
import queue
import sys
import threading
import time
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from logging.handlers import QueueHandler, QueueListener
from pathlib import Path
from typing import Any, Final, TextIO

log = logging.getLogger(__name__)

TEXT, JSON = "text", "json"
TEXT_FORMAT: Final = "%(asctime)s %(levelname)s %(message)s"
LEVELS: Final = {"debug": logging.DEBUG, "info": logging.INFO, "warning": logging.WARNING, "error": logging.ERROR}
# Lines that wait for a reader of stderr; a line has some 100 bytes.
MAX_QUEUED: Final = 1000
# At exit: time for the lines that wait.
STOP_S: Final = 1.0
# Lines of one kind about one address in each interval, and how many of both are counted separately. Ten lines of 100
# bytes a minute are 1.5 MB a day.
MAX_REPEATS: Final = 10
REPEAT_INTERVAL_S: Final = 60.0
MAX_KINDS: Final = 1000
# Attributes of every record; the formatter adds two, and newer versions of Python taskName.
_STANDARD_FIELDS: Final = frozenset(vars(logging.makeLogRecord({}))) | {"message", "asctime", "taskName"}


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add --log-format, --log-level and -v."""
    parser.add_argument("--log-format", choices=(TEXT, JSON), default=TEXT,
                        help="format of stderr: text (default), or json, one object per line")
    parser.add_argument("--log-level", choices=tuple(LEVELS),
                        help="lowest level that is logged on stderr (default: warning; -v info, -vv debug)")
    parser.add_argument("-v", "--verbose", action="count", default=0, help="log more on stderr (-vv: everything)")


@contextlib.contextmanager
def logging_to_stderr(options: argparse.Namespace) -> Iterator[None]:
    """Log to stderr within the block, Python's warnings included; unless the program has configured logging already."""
    root = logging.getLogger()
    # A program that embeds the daemon decides about logging itself.
    if root.handlers:
        yield
        return
    formatter = JsonFormatter() if options.log_format == JSON else logging.Formatter(TEXT_FORMAT)
    stderr = LossCountingHandler(_unbuffered(sys.stderr))
    stderr.setFormatter(formatter)
    handler = BoundedQueueHandler(formatter)
    listener = BoundedListener(handler, stderr)
    logging.basicConfig(level=level_of(options), handlers=[handler])
    logging.captureWarnings(True)
    listener.start()
    try:
        yield
    finally:
        logging.captureWarnings(False)
        root.removeHandler(handler)
        listener.stop()


def level_of(options: argparse.Namespace) -> int:
    """Return the lowest level that is logged: --log-level, or by the number of -v."""
    if options.log_level:
        return LEVELS[options.log_level]
    return (logging.WARNING, logging.INFO, logging.DEBUG)[min(options.verbose, 2)]


def print_line(line: str) -> None:
    """Print a line for programs on stdout; log an error and continue where it cannot be written."""
    try:
        print(line, flush=True)
    except OSError as error:
        log.error("stdout cannot be written: %s; the daemon goes on; the line was: %s", error.strerror, line)
        with Path(os.devnull).open("w") as null:  # for the buffered text, which Python flushes at exit
            os.dup2(null.fileno(), sys.stdout.fileno())


def print_failure(options: argparse.Namespace, error: Exception) -> None:
    """Report the error that ended the daemon, as its last line on stderr."""
    line = f"nserver: {error}"
    if options.log_format == JSON:
        record = _record("nserver: %s", error, level=logging.CRITICAL, name=__package__)
        line = JsonFormatter().format(record)
    # In a thread, since nothing may read stderr.
    writer = threading.Thread(target=_unbuffered(sys.stderr).write, args=(f"{line}\n",), daemon=True)
    writer.start()
    writer.join(STOP_S)


def _unbuffered(stream: TextIO) -> TextIO:
    """Return an unbuffered stream to the same file, so that a line is either written or fails."""
    try:
        raw = io.FileIO(stream.fileno(), "w", closefd=False)
    except OSError:  # not a file: a program has replaced the stream
        return stream
    return io.TextIOWrapper(raw, stream.encoding, "backslashreplace", write_through=True)


class RepeatLimiter:
    """Counts repeated lines instead of writing them: MAX_REPEATS of a template and address in each interval.

    A filter of a handler. `clock` returns seconds, monotonic.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._lock = threading.Lock()
        # Beginning of the interval and number of lines in it, by template and address, oldest first.
        self._counts: dict[tuple[str, str], tuple[float, int]] = {}

    def __call__(self, record: logging.LogRecord) -> bool:
        """Return True if the line is to be written."""
        address = getattr(record, "address", None)
        if address is None:
            return True
        key, now_s = (str(record.msg), str(address)), self._clock()
        with self._lock:
            if key not in self._counts and len(self._counts) >= MAX_KINDS:
                # So many addresses share one count.
                key = key[0], "other addresses"
            begin_s, count = self._counts.setdefault(key, (now_s, 0))
            self._counts[key] = begin_s, count + 1
            return count < MAX_REPEATS

    def summaries(self, *, at_end: bool = False) -> list[logging.LogRecord]:
        """Return a line for each kind with lines that were not written, where its interval is over."""
        now_s, found = self._clock(), []
        with self._lock:
            over = [key for key, (begin_s, _) in self._counts.items() if at_end or now_s - begin_s >= REPEAT_INTERVAL_S]
            for template, address in over:
                begin_s, count = self._counts.pop((template, address))
                if count > MAX_REPEATS:
                    found.append(_record("%s: %d more lines in %.0f s like %r",
                                         address, count - MAX_REPEATS, now_s - begin_s, template))
        return found


class BoundedQueueHandler(QueueHandler):
    """Puts formatted lines into a bounded queue; drops and counts them while it is full."""

    def __init__(self, formatter: logging.Formatter) -> None:
        self.lines: queue.Queue[logging.LogRecord | None] = queue.Queue(MAX_QUEUED)
        super().__init__(self.lines)
        self.setFormatter(formatter)
        self.limiter = RepeatLimiter()
        self.addFilter(self.limiter)
        self.dropped = 0
        """Lines dropped since the last line that was queued."""

    def prepare(self, record: logging.LogRecord) -> logging.LogRecord:
        """Return the record with its line and without the objects it was made of, which may change or be large."""
        prepared: logging.LogRecord = super().prepare(record)
        prepared.is_formatted = True
        return prepared

    def enqueue(self, record: logging.LogRecord) -> None:
        """Queue a line, preceded by the number of dropped ones, if any."""
        try:
            if self.dropped:
                lost = _record("%d lines of this log were lost: nothing read them in time", self.dropped)
                self.lines.put_nowait(self.prepare(lost))
                self.dropped = 0
            self.lines.put_nowait(record)
        except queue.Full:
            self.dropped += 1


class BoundedListener(QueueListener):
    """Writes queued lines in a thread of its own, and waits at most STOP_S for them at the end."""

    def __init__(self, source: BoundedQueueHandler, target: logging.Handler) -> None:
        super().__init__(source.lines, target)
        self._source = source

    def dequeue(self, block: bool) -> logging.LogRecord:
        """Return the next line; report repeated lines meanwhile."""
        while True:
            for record in self._source.limiter.summaries():
                self.handle(record)
            with contextlib.suppress(queue.Empty):
                return self._source.lines.get(block, timeout=REPEAT_INTERVAL_S / 10.0)  # type: ignore[return-value]

    def stop(self) -> None:
        """Write what is queued, then end the thread; after STOP_S without it."""
        for record in self._source.limiter.summaries(at_end=True):
            self._source.enqueue(self._source.prepare(record))
        thread: threading.Thread | None = self._thread
        with contextlib.suppress(queue.Full):
            self._source.lines.put(None, timeout=STOP_S)
            if thread is not None:
                thread.join(STOP_S)
        self._thread = None


def _record(message: str, *args: object, level: int = logging.WARNING, name: str = __name__) -> logging.LogRecord:
    """Return a record that passes no logger; by default a warning about the log itself."""
    return logging.LogRecord(name, level, "", 0, message, args, None)


class LossCountingHandler(logging.StreamHandler[TextIO]):
    """Handler for a stream that may be unwritable for some time."""

    def __init__(self, stream: TextIO) -> None:
        super().__init__(stream)
        self.lost = 0
        """Lines lost since the last line that was written."""

    def createLock(self) -> None:  # noqa: N802 - name given by logging
        """Do without a lock: only one thread writes, and the exit of the program must not wait for it."""
        self.lock = None

    def format(self, record: logging.LogRecord) -> str:
        """Return the line of a record, which was formatted before it was queued."""
        return str(record.msg) if getattr(record, "is_formatted", False) else super().format(record)

    def emit(self, record: logging.LogRecord) -> None:
        """Write a record, preceded by the number of lost lines, if any."""
        # First the number of lost lines; if that fails, this line is not attempted either.
        if self.lost:
            before = self.lost
            super().emit(_record("%d lines of this log were lost: it could not be written", self.lost))
            if self.lost > before:
                return
            self.lost = 0
        super().emit(record)

    def handleError(self, record: logging.LogRecord) -> None:  # noqa: N802 - name given by logging
        """Count a line that cannot be written; report other errors as logging does."""
        if isinstance(sys.exception(), OSError):
            self.lost += 1
        else:
            super().handleError(record)


class JsonFormatter(logging.Formatter):
    """One JSON object per line."""

    def format(self, record: logging.LogRecord) -> str:
        """Return the record as JSON; values that JSON cannot express become strings."""
        # UTC in milliseconds, with Z instead of +00:00 as log collectors write it.
        at = datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds").removesuffix("+00:00")
        fields: dict[str, Any] = {
            "time": f"{at}Z", "level": record.levelname.lower(), "logger": record.name,
            "message": record.getMessage(), "template": str(record.msg),
        }  # fmt: skip
        # What is not a standard attribute of a record came by `extra=`.
        fields |= {name: value for name, value in vars(record).items() if name not in _STANDARD_FIELDS}
        if record.exc_info:
            fields["exception"] = self.formatException(record.exc_info)
        return json.dumps(fields, default=str)
