"""The file: what is written is read back, and whatever is wrong with one is named with its line."""

from __future__ import annotations

import json
import logging
from pathlib import Path

import pytest

from nclient.errors import RecordingError
from nclient.recording import format as log
from nclient.recording.format import Entry, RecordingWriter, parse_recording, read_recording

HEADER = '{"format": "nomad recording", "version": 1, "seed": 7}\n'
# Type 15, no words.
GS = '{"t": 0.25, "dir": "out", "bytes": "000f0000"}\n'


def test_what_is_written_is_read_back(tmp_path: Path) -> None:
    path = tmp_path / "run.log"
    entries = [
        Entry(0.0, "open", "a", more={"wire": "tcp", "model": "n150"}, line=2),
        Entry(0.1, "out", "a", bytes(range(256)), ({"to": "robot", "call": "gs", "args": []},), line=3),
        Entry(0.125, "in", "a", b"", line=4),
        Entry(9.0, "time", more={"steps": [[0.1, 3]]}, line=5),
        Entry(9.5, "close", "a", line=6),
    ]
    writer = RecordingWriter(path, {"seed": 7})
    for entry in entries:
        writer.write(entry)
        # A program that is killed loses at most the line that it was writing.
        assert len(path.read_text().splitlines()) == entry.line, "each line is written at once"
    writer.close()
    writer.close()
    writer.write(entries[0])
    found = read_recording(path)
    assert found.header == {"format": "nomad recording", "version": 1, "seed": 7}
    assert list(found.entries) == entries
    assert (found.cut, found.connections()) == ("", ("a",))


def test_a_line_stands_as_the_docs_say(tmp_path: Path) -> None:
    writer = RecordingWriter(tmp_path / "run.log", {})
    writer.write(Entry(0.5, "in", "", b"\x01\xff", ({"error": "x"},)))
    writer.close()
    _, line = (tmp_path / "run.log").read_text().splitlines()
    assert json.loads(line) == {"t": 0.5, "dir": "in", "bytes": "01ff", "decoded": [{"error": "x"}]}


@pytest.mark.parametrize("cut_at", range(1, len(GS) - 1))
def test_incomplete_last_line_is_omitted_and_reported(cut_at: int) -> None:
    found = parse_recording(HEADER + GS + GS[:cut_at], "run.log")
    assert [entry.data for entry in found.entries] == [b"\x00\x0f\x00\x00"]
    assert found.cut == f"run.log, line 3: cut short after {cut_at} characters, and left out"


def test_a_last_line_that_lacks_its_end_only_counts() -> None:
    found = parse_recording(HEADER + GS + GS.rstrip(), "run.log")
    assert (len(found.entries), found.cut) == (2, "")
    assert parse_recording(HEADER.rstrip(), "run.log").entries == ()
    # Empty lines are skipped, and counted, so that messages name the right line.
    assert parse_recording(HEADER + "\n" + GS, "run.log").entries[0].line == 3


@pytest.mark.parametrize(("text", "reported"), [
    ("", "line 1: no recording; one begins with"),
    ("not json\n", "line 1: no recording"),
    ("[]\n", "line 1: no recording"),
    ('{"format": "tape"}\n', "line 1: no recording"),
    ('{"format": "nomad recording", "version": 2}\n', "line 1: version 2; this program reads version 1"),
    (HEADER + "junk\n" + GS, "line 2: no entry of a recording .*; mend it or take it out"),
    (HEADER + GS + '{"t": 1, "dir": "up", "bytes": ""}\n', "line 3: .*nothing is 'up'"),
    (HEADER + '{"t": 1, "event": "out"}\n', "line 2: .*nothing is 'out'"),
    (HEADER + '{"t": 1, "dir": "in", "bytes": "0g"}\n', "line 2: "),
    (HEADER + '{"dir": "in", "bytes": ""}\n', "line 2: .*'t'"),
    (HEADER + "[1]\n", "line 2: "),
    # Brackets as deep as this exceed the recursion limit of the JSON parser.
    ("[" * 100_000, "line 1: no recording"),
    (HEADER + "[" * 100_000 + "\n", "line 2: .*RecursionError"),
    (HEADER + f'{{"t": {10**400}, "dir": "in", "bytes": ""}}\n', "line 2: .*OverflowError"),
    (HEADER + '{"t": NaN, "dir": "in", "bytes": ""}\n', "line 2: .*t is seconds"),
    (HEADER + '{"t": 1, "dir": "in", "bytes": "", "decoded": [3]}\n', "line 2: .*decoded a list of objects"),
])
def test_what_is_no_recording(text: str, reported: str) -> None:
    with pytest.raises(RecordingError, match=f"run.log, {reported}"):
        parse_recording(text, "run.log")


def test_a_recording_is_as_long_as_it_is_and_a_line_is_not(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(log, "MAX_LINE", len(HEADER))
    path = tmp_path / "run.log"
    path.write_text(HEADER + 1000 * GS)
    assert len(read_recording(path).entries) == 1000
    # 20 blanks make the line longer than the limit, with a valid entry in it.
    path.write_text(HEADER + GS + GS.rstrip() + 20 * " " + "\n")
    with pytest.raises(RecordingError, match=r"run\.log, line 3: longer"):
        read_recording(path)


@pytest.mark.skipif(not Path("/dev/zero").exists(), reason="the system has no /dev/zero")
def test_what_is_no_recording_is_not_read_to_its_end(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(log, "MAX_LINE", 10_000)
    # A device without end and without line breaks: reading must stop at the limit.
    with pytest.raises(RecordingError, match=r"/dev/zero, line 1: .* 10000"):
        read_recording(Path("/dev/zero"))


def test_lines_of_another_system_are_read_as_well(tmp_path: Path) -> None:
    path = tmp_path / "run.log"
    path.write_bytes((HEADER + GS + "\n" + GS).replace("\n", "\r\n").encode())
    assert [entry.line for entry in read_recording(path).entries] == [2, 4]


def test_files_that_cannot_be(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="cannot be read"):
        read_recording(tmp_path / "none.log")
    with pytest.raises(RecordingError, match="embedded null byte"):
        read_recording(tmp_path / "run\0.log")
    with pytest.raises(RecordingError, match="cannot be written"):
        RecordingWriter(tmp_path / "nowhere" / "run.log", {})


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="the system has no /dev/full")
def test_full_disk_is_logged_once_and_the_run_continues(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.ERROR):
        # Every write to /dev/full fails with "no space left".
        writer = RecordingWriter(Path("/dev/full"), {})
        for _ in range(3):
            writer.write(Entry(0.0, "in", "", bytes(100_000)))
        writer.close()
        writer.close()
    assert writer.failed
    assert [record.message for record in caplog.records] == [
        "/dev/full: no longer recorded; the run goes on, what was written can be read: No space left on device; make "
        "room on that disk, or name a file on another, and begin another recording"
    ]


def test_recording_at_its_maximum_size_ends_with_a_whole_line(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "run.jsonl"
    log = RecordingWriter(path, {}, max_bytes=1000)
    for number in range(100):
        log.write(Entry(float(number), "out", "one", b"\0" * 10))
    log.close()
    # The entry that would exceed 1000 bytes is left out whole.
    assert 900 < path.stat().st_size <= 1000
    recording = read_recording(path)
    assert not recording.cut
    assert [entry.time_s for entry in recording.entries] == [float(n) for n in range(len(recording.entries))]
    assert caplog.text.count("it has reached its maximum size (--limit-log)") == 1
