"""Responses to `nserver ctl` by a process that is no server of this version become error messages."""

from __future__ import annotations

import pytest

from nclient.errors import ControlError
from nserver_emu.control.cli import NO_ANSWER, format_result, parse_response


@pytest.mark.parametrize(
    "answer",
    [
        b"", b"\n", b"\xff\n", b"[" * 5000 + b"\n", b"[]\n", b"3\n", b"null\n", b"{}\n", b'{"ok": false}\n',
        b'{"ok": true}\n', b'{"ok": true, "said": 3}\n', b"1" * 5000 + b"\n",
    ],
)  # fmt: skip
def test_an_invalid_response_is_an_error(answer: bytes) -> None:
    with pytest.raises(ControlError, match=NO_ANSWER):
        parse_response(answer)


def test_a_refusal_has_its_reason_or_none() -> None:
    with pytest.raises(ControlError, match="it cannot be"):
        parse_response(b'{"ok": false, "error": "it cannot be"}')
    for wordless in (b"", b" ", rb"\n\t"):
        with pytest.raises(ControlError, match="without a reason"):
            parse_response(b'{"ok": 0, "error": "%s"}' % wordless)
    with pytest.raises(ControlError, match=r"\\ud800"):
        parse_response(b'{"ok": false, "error": "\\ud800"}')


@pytest.mark.parametrize(
    "result", ['{"plan": 3}', '{"robots": [{}]}', '{"held": [1]}', '{"counts": {"a": 1}}', '{"noise": "x"}',
             '{"time_s": 1' + 400 * "0" + ', "paused": true}'],
)  # fmt: skip
def test_an_unknown_result_names_the_json_option(result: str) -> None:
    with pytest.raises(ControlError, match="--json"):
        format_result(parse_response(b'{"ok": true, "said": %s}' % result.encode()))


def test_half_a_surrogate_is_shown_escaped() -> None:
    assert format_result({"saved": "\ud800"}) == [r"saved: \ud800"]
