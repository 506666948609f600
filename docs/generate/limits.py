"""Generate the tables of docs/limits.md from the table of limits."""

from __future__ import annotations

from collections.abc import Iterator

from nclient.recording.format import MAX_LINE
from nserver_emu.server.admission import SNAPSHOT_BYTES, TABLE
from worlds.schema import MAX_BYTES


def blocks() -> dict[str, Iterator[str]]:
    """Return the tables of the page."""
    return {"limits": _limits(), "files": _files()}


def _limits() -> Iterator[str]:
    yield from ("| option | default | unit | applies to | effect when exceeded |", "|---|---|---|---|---|")
    for row in TABLE:
        none = " (0: none)" if row.may_be_none else ""
        yield f"| `{row.option}` | {row.default}{none} | {row.unit} | {row.guards} | {row.reached} |"


def _files() -> Iterator[str]:
    yield from ("| file | maximum size |", "|---|---|")
    yield f"| world, setup, model, calibration | {MAX_BYTES >> 20} MiB |"
    yield f"| snapshot | {SNAPSHOT_BYTES >> 20} MiB; `--save` writes no larger file |"
    yield f"| recording | unlimited, read line by line; a line up to {MAX_LINE >> 20} Mi characters |"
