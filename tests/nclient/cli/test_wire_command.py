"""`nomad wire`: encode, decode and dump from the command line, once through a real process."""

from __future__ import annotations

import io
import json
import subprocess
import sys
from collections.abc import Callable
from typing import Any

import pytest

from nclient.cli import main
from nclient.cli.shell_session import describe_unknown_command
from nclient.protocol.commands import BY_NAME

# vm 100 -50 0: type 12 and 3 words; on the line type 5 and three int16 in sign-magnitude.
VM_TCP, VM_LINE = "000c000300000064ffffffce00000000", "01080005640032800000245c"
Nomad = Callable[..., tuple[int, str]]


@pytest.fixture
def nomad(capsys: pytest.CaptureFixture[str]) -> Nomad:
    """Runs `nomad wire` with these words: exit code and what it printed on stdout."""
    def run(*words: str) -> tuple[int, str]:
        code = main.main(["wire", *words])
        return code, capsys.readouterr().out

    return run


@pytest.mark.parametrize("words", [
    "encode vm 100 -50 0 --line {}", "encode --line {} vm 100 -50 0", "--line {} encode vm 100 -50 0",
])
@pytest.mark.parametrize(("wire", "hexed"), [
    # A 64-bit client sends four zero bytes before each word.
    ("tcp", VM_TCP), ("serial", VM_LINE), ("tcp64", "000c0003000000000000006400000000ffffffce0000000000000000"),
])
def test_encode_on_each_line_with_the_option_anywhere(nomad: Nomad, words: str, wire: str, hexed: str) -> None:
    assert nomad(*words.format(wire).split()) == (0, f"{hexed}\n")


@pytest.mark.parametrize(("words", "hexed"), [
    ("gs", "000f0000"),
    # Type 0x66 = 102, 2 words: robot number and process number.
    ("connect_robot 1 --pid 23594", "00660002" "00000001" "00005c2a"),
    # Seven mask bytes, one a word: all sensors, 0x0e for Smask[41] to [43], no position data.
    ("ct", "00100007" + "000000ff" * 5 + "0000000e" "00000000"),
    # Length 6 = 4 + 2 bytes of data, serial number 0, packet type 200 = 0xc8, data; one byte a word.
    ("special_request 1 250 --packet-type 200",
     "012c0006" "00000006" "00000000" "00000000" "000000c8" "00000001" "000000fa"),
    # "hi" and its NUL in one word, low byte first in the word.
    ("tk hi", "00130001" "00006968"),
    # -12345 / 10 is truncated toward zero: -1234 = 0xfffffb2e.
    ("motion_check 0 0 0 -12345 9", "01900008" + "00000000" * 3 + "fffffb2e" + "00000000" * 4),
    # 1570.5 thousandths of a radian are 1570500 = 0x17f6c4 millionths.
    ("motion_check 1 0 0 1570.5 0 0 0 0", "01900008" "00000001" + "00000000" * 2 + "0017f6c4" + "00000000" * 4),
    ("place_robot 1 -2 3 4", "00290004" "00000001" "fffffffe" "00000003" "00000004"),
    # On the serial line it is two frames: dp (type 12) and da (type 30).
    ("place_robot 1 -2 3 4 --line serial", "0106000c01000280965c\n0106001e030004002c5c"),
    # Mode 51 is sent as 35 = 0x23, and the word num_data low byte first.
    ("conf_ls 51 20 20 20 4 --line serial --model n200", "010800112314141400047d5c"),
    ("tk Where am --line serial --model n200", "010b000b576865726520616d00005c"),
])
def test_encode_calls_with_something_special(nomad: Nomad, words: str, hexed: str) -> None:
    assert nomad("encode", *words.split()) == (0, f"{hexed}\n")


def test_encode_a_mask(nomad: Nomad) -> None:
    mask = ",".join(["2", *["0"] * 16, *["1"] * 27])
    code, hexed = nomad("encode", "ct", "--mask", mask)
    # Position data of the sonars (2) sets bit 0 of byte 5: 0x0f; infrared off.
    assert (code, hexed) == (0, "00100007" + "00000000" * 2 + "000000ff" * 3 + "0000000f" "00000002\n")
    assert json.loads(nomad("decode", hexed.strip())[1])["mask"] == [int(bit) for bit in mask.split(",")]


@pytest.mark.parametrize(("words", "wrong"), [
    ("fly 1", "no command 'fly'; nomad wire encode --help lists them all"),
    ("vn 1 2 3", "no command 'vn'; did you mean vm?; nomad wire encode --help lists them all"),
    ("vm 1 2", "vm takes 3 numbers"), ("vm 1 2 up", "expected a number, not 'up'"),
    ("ct 1", "give the mask with --mask"), ("special_request 1", "needs its --packet-type"),
    ("pa 1 2 3 --line serial", "does not exist on the line of a n150"),
    ("vm 40000 0 0 --line serial", "translation is 40000, and a robot"),
    ("place_robot 1 2 --line serial", "does not exist on the line"), ("motion_check 0 nan 0 0 0", "motion_check"),
])
def test_what_cannot_be_encoded(capsys: pytest.CaptureFixture[str], words: str, wrong: str) -> None:
    assert main.main(["wire", "encode", *words.split()]) == 1
    reported = capsys.readouterr()
    assert reported.out == ""
    assert reported.err.startswith("nomad: ")
    assert wrong in reported.err


@pytest.mark.parametrize(("words", "wrong"), [
    ("encode ct --mask 1,2", "a mask has 44 numbers"), ("encode ct --mask on", "invalid literal"),
    ("decode 00 --line usb", "argument --line: no 'usb'; there are tcp, tcp64, serial"),
    ("decode 00 --model n300", "no 'n300'; there are n150, n200, scout; did you mean n200?"),
    ("", "encode|decode|dump"), ("encode", "the following arguments are required: CALL\n"),
    ("decode zz", "argument HEX: no hex, two digits a byte: zz"), ("decode 00 0", "two digits a byte: 00 0"),
])
def test_arguments_that_make_no_sense(capsys: pytest.CaptureFixture[str], words: str, wrong: str) -> None:
    with pytest.raises(SystemExit, match="2"):
        main.main(["wire", *words.split()])
    reported = capsys.readouterr()
    assert reported.out == ""
    assert wrong in reported.err


@pytest.mark.parametrize("typed", ["vn", "prr", "drive", "get_sonar", "connect", "zzz"])
def test_shell_and_wire_suggest_the_same(
    typed: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main.main(["wire", "encode", typed]) == 1
    by_wire = capsys.readouterr().err.removeprefix("nomad: ").partition("; nomad wire")[0]
    assert main.main(["wire", "decode", "00", "--call", typed]) == 1
    assert capsys.readouterr().err.startswith(f"nomad: {by_wire}; ")
    assert by_wire == describe_unknown_command(typed).removesuffix("; help lists them all")


@pytest.mark.parametrize(("words", "found"), [
    (VM_TCP, {"to": "robot", "call": "vm", "args": [100, -50, 0]}),
    (f"--line serial {VM_LINE[:12]} {VM_LINE[12:]}", {"to": "robot", "call": "vm", "args": [100, -50, 0]}),
    (f"{VM_TCP[:5]} {VM_TCP[5:]}", {"to": "robot", "call": "vm", "args": [100, -50, 0]}),
])
def test_decode_a_request(nomad: Nomad, words: str, found: dict[str, Any]) -> None:
    code, printed = nomad("decode", *words.split())
    assert (code, json.loads(printed)) == (0, found)


@pytest.mark.parametrize("words", ["000c", "--to host 000c"])
def test_what_is_no_good_frame_has_its_reason_on_stderr_alone(words: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main.main(["wire", "decode", *words.split()]) == 1
    assert capsys.readouterr() == ("", "nomad: truncated: 2 bytes are no whole message\n")


def test_decode_a_reply_of_the_call_that_is_named(nomad: Nomad) -> None:
    # Type 0x58 = 88, four words.
    reply = "00580004" "fffffd0e" "fffffc53" "00001dc8" "00002036"
    by_type = json.loads(nomad("decode", "--to", "host", reply)[1])
    # The type alone is that of get_rc, which is stored in State; get_robot_conf returns the values and stores
    # nothing.
    clicked = json.loads(nomad("decode", "--to", "host", "--call", "get_robot_conf", reply)[1])
    assert by_type["State"][34:38] == [-754, -941, 7624, 8246]
    assert (clicked["obs"], clicked["State"][34]) == ([-754, -941, 7624, 8246], None)


def test_decode_a_packet_by_mask_and_laser_mode(nomad: Nomad) -> None:
    mask = ",".join("1" if slot == 42 else "0" for slot in range(44))
    # A count of 1, one line with the numbers -1, 2, 3 and -4, motor status 2, clock 16 ms, battery bytes 0 and 255.
    packet = "011300070100" "0180" "0200" "0300" "0480" "02" "10000000" "00ff"
    # The checksum covers all bytes before it, modulo 256.
    total = sum(bytes.fromhex(packet)) & 255
    words = f"decode --to host --line serial --model n200 --mask {mask} --laser-mode 33 {packet}{total:02x}5c"
    code, printed = nomad(*words.split())
    found = json.loads(printed)
    assert (code, found["Laser"], found["State"][41], found["clock"]) == (0, [1, -1, 2, 3, -4], 2, 16)
    # (2 + 0) x 12 / 5 = 4.8 V, and the whole range of 12.85 V.
    assert (found["volt_cpu"], found["volt_motor"]) == (4.8, 12.85)


def test_dump_has_an_object_for_each_line(nomad: Nomad, monkeypatch: pytest.MonkeyPatch) -> None:
    lines = b"> 000f0000\n\n# note\n< 0052000100000000\r\n\xff\xfe\n> 00 0f 00 00"
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(lines)))
    code, printed = nomad("dump")
    found = [json.loads(line) for line in printed.splitlines()]
    assert code == 0
    # A request, an empty line, a comment, a reply, bytes that are no text, a request with blanks: one object for
    # each.
    assert [next(iter(item)) for item in found] == ["to", "error", "error", "to", "error", "to"]
    assert found[3]["values"] == [0]


def test_dump_as_a_process_answers_each_line_at_once() -> None:
    command = [sys.executable, "-c", "import sys; from nclient.cli.main import main; sys.exit(main())", "wire", "dump"]
    with subprocess.Popen(
        [*command, "--line", "serial", "--model", "n150"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdin
        assert process.stdout
        process.stdin.write(f"> {VM_LINE}\n")
        process.stdin.flush()
        # The reply must come before the input ends: output is flushed for each line.
        first = json.loads(process.stdout.readline())
        rest, _ = process.communicate("< 010200080b5c\n", timeout=20)
    assert first == {"to": "robot", "call": "vm", "args": [100, -50, 0]}
    assert json.loads(rest)["reply"] == "nak"
    assert process.returncode == 0


def test_help_lists_the_calls(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="0"):
        main.main(["wire", "encode", "--help"])
    assert set(BY_NAME) <= set(capsys.readouterr().out.partition("Calls:")[2].split())


@pytest.mark.parametrize("words", ["wire", "wire encode", "wire decode", "wire dump"])
def test_help_has_examples(capsys: pytest.CaptureFixture[str], words: str) -> None:
    with pytest.raises(SystemExit, match="0"):
        main.main([*words.split(), "--help"])
    assert "nomad wire" in capsys.readouterr().out.partition("\n\n")[2]
