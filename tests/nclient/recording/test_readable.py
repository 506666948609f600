"""Readable recordings with edited or damaged lines; `nomad dump` of valid ones is tested in tests/nclient/cli."""

from __future__ import annotations

from typing import Any

import pytest

from nclient.errors import RecordingError
from nclient.recording.format import Entry, format_entry


@pytest.mark.parametrize("found", [
    {}, {"reply": "state"}, {"call": "vm"}, {"call": "vm", "args": 3}, {"reply": "sonar", "clock": "late"},
    {"reply": "state", "State": [0] * 45, "clock": 3}, {"reply": [], "values": 3.5},
])
def test_foreign_frames_are_reported_with_their_line(found: dict[str, Any]) -> None:
    with pytest.raises(RecordingError, match=r"line 7: `decoded`"):
        list(format_entry(Entry(0.0, "in", decoded=(found,), line=7)))


def test_what_is_wrong_with_bytes_is_shown() -> None:
    entry = Entry(1.5, "in", "a", b"\1", ({"error": "1 bytes that are no frame"},), line=7)
    assert [line.split() for line in format_entry(entry, with_bytes=True)] == [
        ["1.500", "a", "<", "!", "1", "bytes", "that", "are", "no", "frame"], ["1.500", "a", "<", "[01]"],
    ]  # fmt: skip


def test_control_characters_are_escaped() -> None:
    hostile, shown = "\x1b[2J\r\n\x9b\u202e\ud800é", r"\x1b[2J\r\n\x9b\u202e\ud800é"
    frames = ({"error": hostile}, {"call": hostile, "args": [hostile]}, {"reply": hostile})
    lines = list(format_entry(Entry(0.0, "in", hostile, decoded=frames)))
    lines += format_entry(Entry(0.0, "open", hostile, more={"wire": hostile, "model": hostile}))
    assert len(lines) == 4
    assert all(line.isprintable() and line.count(shown) >= 2 for line in lines)
