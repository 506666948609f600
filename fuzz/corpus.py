"""The corpus: for each reader few small inputs that between them reach all the code that was ever reached.

Rules: worth keeping is what reaches a step from line to line in our packages that no shorter input reached; kinds of
counts do not matter. At most MOST_FILES and MOST_BYTES a reader.
"""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Iterable
from pathlib import Path
from types import FrameType
from typing import Any, Final

from fuzz.reader import CORPUS, Reader

MOST_FILES: Final = 100
MOST_BYTES: Final = 200_000
_ROOT = Path(__file__).parents[1]
_PACKAGES = tuple(f"{_ROOT / name}/" for name in ("nclient", "nserver_emu", "localization", "worlds"))
Steps = set[tuple[str, int, int]]


def steps_of(reader: Reader, data: bytes) -> Steps:
    """The steps from line to line that reading an input takes in our packages; of what it raises nothing is told."""
    steps: Steps = set()
    last: dict[int, int] = {}

    def in_frame(frame: FrameType, event: str, _argument: Any) -> Any:
        if event == "line":
            steps.add((frame.f_code.co_filename, last.get(id(frame), 0), frame.f_lineno))
            last[id(frame)] = frame.f_lineno
        return in_frame

    def called(frame: FrameType, _event: str, _argument: Any) -> Any:
        last.pop(id(frame), None)  # of one that is over, whose place it has
        return in_frame if frame.f_code.co_filename.startswith(_PACKAGES) else None

    before = sys.gettrace()
    sys.settrace(called)
    try:
        reader.take(data)
    except Exception:  # noqa: BLE001 what shows a fault is told by a campaign, and is no example
        return set()
    finally:
        sys.settrace(before)
    return steps


def worth_keeping(reader: Reader, inputs: Iterable[bytes]) -> list[bytes]:
    """Those inputs, the shortest first, that reach something new."""
    reached: Steps = set()
    kept: list[bytes] = []
    size = 0
    for data in sorted(set(inputs), key=lambda data: (len(data), data)):
        if len(kept) >= MOST_FILES or size + len(data) > MOST_BYTES:
            break
        new = steps_of(reader, data) - reached
        if new:
            reached |= new
            kept.append(data)
            size += len(data)
    return kept


def keep(reader: Reader, work: Path) -> int:
    """Put what a campaign found worth keeping into the corpus, with what was there; how many inputs that makes."""
    grown = [path.read_bytes() for path in (work / reader.name).glob("*")]
    inputs = worth_keeping(reader, [*reader.seeds(), *reader.kept(), *grown])
    folder = CORPUS / reader.name
    folder.mkdir(parents=True, exist_ok=True)
    for path in folder.glob("*"):
        path.unlink()
    for data in inputs:
        (folder / hashlib.sha1(data).hexdigest()[:16]).write_bytes(data)
    return len(inputs)
