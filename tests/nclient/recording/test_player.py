"""Player: recorded replies, and errors that name the place of an unrecorded request."""

from __future__ import annotations

from pathlib import Path

import pytest

from nclient import RecordingError, Robot, connect
from nclient.connector import Connector
from nclient.protocol import codec
from nclient.protocol.client_state import Handshake, build_handshake
from nclient.protocol.commands import BY_NAME, Call
from nclient.protocol.replies import Reply
from nclient.protocol.types import EVERYTHING, N150, N200, serial_wire_state, tcp_wire_state
from nclient.recording.format import Entry, Recording
from nclient.recording.replayer import LOOSE, STRICT, Player, ReplayPeer, ReplyChunk, RequestKey, load_exchanges
from nclient.url import parse_address
from tests.nclient.protocol.recorded import LP64

SIM = "sim:thesis_room?noisy=1&seed=8"


def run(robot: Robot) -> list[tuple[int, ...]]:
    """A run with all that State can show; what it saw."""
    with robot:
        seen = [robot.drive(translation_in_s=6, steering_deg_s=10), robot.wait_until_still(1), robot.read_sonars()]
        seen += [robot.refresh() for _ in range(5)]
        robot.say("driving")
        return [state.raw for state in seen]


def test_a_recorded_run_is_replayed_without_a_robot(tmp_path: Path) -> None:
    path = tmp_path / "a run.log"
    seen = run(connect(f"{SIM}&record={path}"))
    # Strict order first, then loose; both must give the states of the recorded run.
    assert run(connect(f"replay:{path}")) == seen
    assert run(connect(f"replay:{str(path).replace(' ', '%20')}?order=loose")) == seen


def test_sleep_is_refused_where_it_was_not_recorded() -> None:
    player = Player(load_exchanges(FED))
    # Error 4: a recording cannot let simulated time pass.
    refusal = codec.encode_tcp_reply(BY_NAME["sim_control"], Reply("error", values=(4,)), tcp_wire_state(N150))
    assert asked(player, "sim_control", 4, 100) == refusal
    # It is no part of the order.
    assert asked(player, "vm", 1, 2, 3) == answer("vm", 1).data


@pytest.mark.parametrize("sleeps", [True, False])
def test_program_that_sleeps_replays_its_run(sleeps: bool, tmp_path: Path) -> None:
    def drive(address: str, *, sleeps: bool) -> list[tuple[int, ...]]:
        with connect(address) as robot:
            seen = [robot.drive(translation_in_s=6)]
            if sleeps:
                robot.sleep(0.5)
            return [state.raw for state in (*seen, robot.refresh())]

    # Without sleeping: as recorded on a server or a robot, where a pause is no request.
    seen = drive(f"{SIM}&record={tmp_path}/run.log", sleeps=sleeps)
    assert drive(f"replay:{tmp_path}/run.log", sleeps=True) == seen


def test_a_played_run_can_be_recorded_and_is_the_same(tmp_path: Path) -> None:
    run(connect(f"{SIM}&record={tmp_path}/one.log"))
    run(connect(f"replay:{tmp_path}/one.log?record={tmp_path}/two.log"))
    one, two = ((tmp_path / name).read_text().splitlines() for name in ("one.log", "two.log"))
    # The first line, the header, names the address.
    assert one[1:] == two[1:]


def test_unrecorded_request_is_reported_with_its_line(tmp_path: Path) -> None:
    run(connect(f"{SIM}&record={tmp_path}/run.log"))
    robot = connect(f"replay:{tmp_path}/run.log")
    # vm was recorded at line 7, and the program sends pr.
    with pytest.raises(RecordingError, match=r"line 7: .*`vm 60 100 0`.*`pr 30 0 0`"):
        robot.move(translation_in=3)
    assert robot.closed


def test_unknown_order_is_rejected(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="one of strict, loose"):
        connect(f"replay:{tmp_path}/run.log?order=lose")


def recording(*entries: Entry, **header: str) -> Recording:
    return Recording("run.log", header, entries)


def ask(name: str, *args: int, at: float = 0.0, connection: str = "") -> Entry:
    return Entry(at, "out", connection, codec.encode_tcp_request(Call(name, args)), line=round(10 * at) + 2)


def answer(name: str, x: int, at: float = 0.0, connection: str = "") -> Entry:
    reply = Reply("state", {34: x}) if BY_NAME[name].tcp_reply.kind == "state" else Reply("simple", values=(x,))
    return Entry(at, "in", connection, codec.encode_tcp_reply(BY_NAME[name], reply, tcp_wire_state(N150)))


def asked(player: Player, name: str, *args: int) -> bytes:
    return b"".join(piece.data for piece in player.answers(codec.encode_tcp_request(Call(name, args))))


FED = recording(
    # What a program sends with its keep-alive: conf_tm at the start and gs at any time.
    ask("conf_tm", 5), answer("conf_tm", 0), ask("vm", 1, 2, 3), answer("vm", 1), ask("gs"), answer("gs", 2),
    ask("gs"), answer("gs", 3), ask("st", at=0.5), answer("st", 4, at=0.75), ask("gs"), answer("gs", 5),
)


def test_keep_alive_requests_may_be_omitted() -> None:
    player = Player(load_exchanges(FED))
    # The recorded conf_tm is not sent here: requests of the keep-alive may be missing.
    assert asked(player, "vm", 1, 2, 3) == answer("vm", 1).data
    assert asked(player, "gs") == answer("gs", 2).data
    # 0.5 s to 0.75 s: the reply takes 0.25 s.
    assert player.answers(codec.encode_tcp_request(Call("st"))) == [ReplyChunk(0.25, answer("st", 4).data)]
    assert player.remaining == 1
    with pytest.raises(RecordingError, match=r"run\.log, line 2: .*`gs`.*`st`"):
        asked(player, "st")
    assert asked(player, "gs") == answer("gs", 5).data
    with pytest.raises(
        RecordingError, match=r"run\.log: .*ends .*`gs`"
    ):
        asked(player, "gs")
    assert asked(player, "disconnect_robot", 1, 77) == b"", "leaving is always allowed"


def test_strict_leaves_nothing_else_out() -> None:
    with pytest.raises(RecordingError, match=r"line 2: .*`vm 1 2 3`.*`vm 1 2 4`"):
        asked(Player(load_exchanges(FED)), "vm", 1, 2, 4)
    with pytest.raises(RecordingError, match=r"recorded .*`vm 1 2 3`.* sends `st`"):
        asked(Player(load_exchanges(FED)), "st")


def test_loose_answers_as_the_next_like_it() -> None:
    # Loose: the next recorded request with the same bytes, and everything before it is skipped.
    player = Player(load_exchanges(FED), LOOSE)
    assert asked(player, "gs") == answer("gs", 2).data
    assert asked(player, "st") == answer("st", 4).data
    with pytest.raises(RecordingError, match=r"run\.log: `vm 1 2 3` .*line 2"):
        asked(player, "vm", 1, 2, 3)


def test_process_ids_do_not_count_and_pieces_do_not_matter() -> None:
    # The process number differs from the recorded 4711.
    player = Player(load_exchanges(recording(ask("connect_robot", 3, 4711), answer("connect_robot", 7019))))
    request = codec.encode_tcp_request(Call("connect_robot", (3, 5)))
    assert player.answers(request[:5]) == []
    assert player.answers(request[5:])[0].data == answer("connect_robot", 7019).data
    assert load_exchanges(recording(ask("connect_robot", 3, 4711))).robot_id == 3
    assert load_exchanges(FED).robot_id == 1


def test_pipelined_requests_are_played_one_by_one() -> None:
    # Three requests in one segment; the reply to the last one is cut into two segments.
    piled = Entry(0.0, "out", "", ask("gs").data + ask("disconnect_robot", 1, 1).data + ask("st").data, line=2)
    both = Entry(0.5, "in", "", answer("gs", 1).data + answer("st", 2).data[:9])
    rest = Entry(0.7, "in", "", answer("st", 2).data[9:])
    player = Player(load_exchanges(recording(piled, both, rest)))
    assert player.answers(ask("gs").data) == [ReplyChunk(0.5, answer("gs", 1).data)]
    assert asked(player, "disconnect_robot", 1, 1) == b""
    # The reply is complete with its second segment, at 0.7 s.
    assert player.answers(ask("st").data) == [ReplyChunk(0.7, answer("st", 2).data)]


def test_what_was_refused_is_refused_again() -> None:
    # Type 99 does not exist; the server answered with error 1.
    unknown = b"\x00\x63\x00\x00"
    refusal = codec.encode_tcp_reply(BY_NAME["gs"], Reply("error", values=(1,)), tcp_wire_state(N150))
    # ws (type 0x27 = 39) with four words of 0, which was answered by a state.
    bad = b"\x00\x27\x00\x04" + bytes(16)
    script = load_exchanges(recording(
        Entry(0, "out", "", unknown, line=2), Entry(0, "in", "", refusal),
        Entry(0, "out", "", bad, line=4), Entry(0, "in", "", answer("gs", 1).data),
    ))
    player = Player(script)
    assert player.answers(unknown) == [ReplyChunk(0, refusal)]
    with pytest.raises(RecordingError, match=r"line 4: .*`ws 0 0 0 0`.*bytes"):
        player.answers(unknown)
    assert str(RequestKey("ct", tuple(EVERYTHING.smask))) == "`ct`"


def test_invalid_calls_are_distinguished_by_their_bytes() -> None:
    def odd(mark: int) -> bytes:
        # Type 0x012c = 300 with a length of -1: no valid call, so that only its bytes can be compared.
        return b"\x01\x2c\x00\x04" + bytes((0xFF, 0xFF, 0xFF, 0xFF)) * 3 + bytes((0, 0, 0, mark))

    (found,) = load_exchanges(recording(Entry(0, "out", "", odd(1), line=2))).exchanges
    assert found.request.error
    with pytest.raises(RecordingError, match="are no call"):
        Player(load_exchanges(recording(Entry(0, "out", "", odd(1), line=2)))).answers(odd(2))


def test_a_client_of_64_bits() -> None:
    wire = [(bytes.fromhex(e["request"]), bytes.fromhex(e.get("reply", ""))) for e in LP64["exchanges"]]
    entries = [Entry(0, kind, "", data) for pair in wire for kind, data in zip(("out", "in"), pair, strict=True)]
    player = Player(load_exchanges(recording(*entries)))
    assert [b"".join(p.data for p in player.answers(request)) for request, _ in wire] == [reply for _, reply in wire]


LINE_STATE = codec.encode_serial_reply(BY_NAME["gs"], Reply("state", {34: 7}), serial_wire_state(N150))
LINE_GS = codec.encode_serial_request(Call("gs"), serial_wire_state(N150))


def test_unrecorded_conf_tm_gets_the_last_state() -> None:
    player = Player(load_exchanges(recording(
        ask("connect_robot", 1, 1), answer("connect_robot", 1), ask("gs"), answer("gs", 3), ask("st"), answer("st", 4),
    )))
    # Before any state was sent, the first one of the recording is the reply.
    assert asked(player, "conf_tm", 5) == answer("gs", 3).data, "the first to come, before there was any"
    asked(player, "connect_robot", 1, 2)
    asked(player, "gs")
    asked(player, "st")
    # Afterwards it is the last state that was sent.
    assert asked(player, "conf_tm", 5) == answer("st", 4).data
    silent = Player(load_exchanges(recording(ask("connect_robot", 1, 1), answer("connect_robot", 1))))
    with pytest.raises(RecordingError, match="sends `conf_tm 5`"):
        asked(silent, "conf_tm", 5)


def test_a_time_out_on_a_robots_line_too() -> None:
    conf_tm = codec.encode_serial_request(Call("conf_tm", (5,)), serial_wire_state(N150))
    reported = codec.encode_serial_reply(BY_NAME["conf_tm"], Reply("state", {34: 7}), serial_wire_state(N150))
    line = {"wire": "serial"}
    entries = [Entry(0, "out", "", LINE_GS, line=2), Entry(0, "in", "", LINE_STATE[:8]),
               # The first reply is incomplete, the second one whole, behind a stray byte.
               Entry(1, "out", "", LINE_GS), Entry(1, "in", "", b"\x55" + LINE_STATE)]
    assert Player(load_exchanges(recording(*entries, **line))).answers(conf_tm) == [ReplyChunk(0.0, reported)]
    sonars = Entry(0, "out", "", codec.encode_serial_request(Call("get_sn"), serial_wire_state(N150)), line=2)
    for nothing in ((*entries[:2],), (sonars, Entry(0, "in", "", LINE_STATE))):
        with pytest.raises(RecordingError):
            Player(load_exchanges(recording(*nothing, **line))).answers(conf_tm)


def test_serial_replay_includes_stray_bytes_and_silence() -> None:
    entries = [
        Entry(0, "open", "1", more={"wire": "serial", "model": "n150"}), Entry(0, "in", "1", b"\xee\xee"),
        # A stray byte before the request; a reply that lacks one byte; a request without a reply; a whole reply.
        Entry(1.0, "out", "1", b"\x55" + LINE_GS), Entry(1.1, "in", "1", LINE_STATE[:9]),
        Entry(1.3, "in", "1", LINE_STATE[10:]), Entry(2.0, "out", "1", LINE_GS), Entry(3.0, "out", "1", LINE_GS),
        Entry(3.1, "in", "1", LINE_STATE), Entry(4, "close", "1"),
    ]
    player = Player(load_exchanges(recording(*entries)))
    assert player.initial == [ReplyChunk(0.0, b"\xee\xee")]
    first, second = player.answers(LINE_GS)
    assert (first.data, second.data) == (LINE_STATE[:9], LINE_STATE[10:])
    assert [first.after_s, second.after_s] == pytest.approx([0.1, 0.3])
    # Noise of the program is no request.
    assert player.answers(b"\x77\x01") == []
    assert player.answers(LINE_GS) == []
    assert [piece.data for piece in player.answers(LINE_GS)] == [LINE_STATE]


def test_eleven_bytes_come_first() -> None:
    hello = build_handshake(Handshake(EVERYTHING, 51))
    header = {"wire": "hello", "model": "n200"}
    script = load_exchanges(recording(Entry(0, "in", "", hello), Entry(1, "out", "", LINE_GS), **header))
    assert script.model is N200
    peer = ReplayPeer(Player(script))
    assert peer.receive() == hello
    assert peer.receive() == b""
    peer.send(LINE_GS)
    assert peer.receive() == b""
    peer.close()


def test_one_of_several_connections(tmp_path: Path) -> None:
    both = recording(
        ask("gs", connection="a"), ask("gs", connection="b"), answer("gs", 2, connection="b"),
        answer("gs", 1, connection="a"),
    )
    assert asked(Player(load_exchanges(both)), "gs") == answer("gs", 1).data
    assert asked(Player(load_exchanges(both, "b"), STRICT), "gs") == answer("gs", 2).data
    for _ in range(2):
        run(connect(f"{SIM}&record={tmp_path}/run.log"))
    assert run(connect(f"replay:{tmp_path}/run.log?connection=1"))
    with pytest.raises(RecordingError, match=r"connection '2'.* 1"):
        connect(f"replay:{tmp_path}/run.log?connection=2")


@pytest.mark.parametrize(("broken", "reported"), [
    (recording(), "run.log: nothing was recorded in it"),
    (recording(ask("gs"), wire="usb"), "a connection's wire is one of tcp, serial, hello, not 'usb'"),
    (recording(ask("gs"), model="r2d2"), "run.log: no robot model 'r2d2'"),
])
def test_recordings_that_cannot_be_played(broken: Recording, reported: str) -> None:
    with pytest.raises(RecordingError, match=reported):
        load_exchanges(broken)


def test_each_time_it_is_opened_the_next_connection_is_played(tmp_path: Path) -> None:
    path = tmp_path / "run.log"
    taped = Connector(parse_address(f"{SIM}&record={path}"))
    for turn in (1, 2):
        backend = taped.open()
        backend.execute(Call("vm", (turn, 0, 0)))
        backend.close()
    played = Connector(parse_address(f"replay:{path}"))
    # A third opening plays the last connection again.
    for turn in (1, 2, 2):
        backend = played.open()
        backend.execute(Call("vm", (turn, 0, 0)))
        backend.close()


def test_a_file_that_is_none(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="cannot be read"):
        connect(f"replay:{tmp_path}/none.log")
