"""The robot's own line: an answer belongs to its command whatever the line does, and the conversation goes on."""

from __future__ import annotations

import random
from typing import Any

import pytest

from nclient.backends.direct import QUIET_S, DirectBackend
from nclient.backends.wrappers import RetryingBackend
from nclient.errors import ConnectionLost, ReplyTimeout, RobotRefused, WireError
from nclient.protocol.client_state import ClientState, Handshake, build_handshake
from nclient.protocol.commands import BY_NAME, Call
from nclient.protocol.replies import Reply
from nclient.protocol.serial_framing import build_frame
from nclient.protocol.types import EVERYTHING, N150, N200, SCOUT, Model
from nclient.protocol.wire_state import serial_wire_state
from nclient.transports.memory import MemoryStream
from nclient.transports.stream import Deadline
from tests.nclient.protocol.recorded import LINE_SESSIONS, model_of
from tests.nclient.robot_line import NAK, Late, RecordedRobot, ScriptedLine, direct_on, spoiled

GS, ST, RV = Call("gs"), Call("st"), Call("get_rv")
VM = Call("vm", (100, -50, 0))
NAK_FRAME = build_frame(8)


def test_an_exchange() -> None:
    robot = ScriptedLine()
    backend = direct_on(robot)
    assert (backend.greeting, backend.port, backend.closed) == (None, 1, False)
    assert robot.calls == []
    robot.slots[17] = 99
    reply = backend.execute(VM)
    assert (reply.kind, reply.slots[17], reply.clock) == ("state", 99, 1016)
    assert robot.requests.hex() == "01080005640032800000245c"
    assert (backend.link.exchanges, backend.link.answers, backend.link.frames) == (1, 1, 1)


@pytest.mark.parametrize("session", LINE_SESSIONS)
def test_what_the_c_library_said_and_held(session: str) -> None:
    peer = RecordedRobot(session)
    model = model_of(session)
    backend = DirectBackend(MemoryStream(peer), model, hello=session == "n200_tcp", checks=False)
    held = ClientState()
    played = peer.exchanges
    if backend.greeting is not None:
        held.apply_reply(backend.greeting)
        played = played[1:]
    for exchange in played:
        if "Nak" in exchange.prints:
            with pytest.raises(RobotRefused, match="NAK"):
                backend.execute(exchange.call)
            continue
        held.apply_reply(backend.execute(exchange.call))
        if exchange.decoded:
            assert [value or 0 for value in held.slots] == exchange.decoded["State"], exchange.call
    backend.close()


def test_a_n200_is_sent_its_mask_and_asked_again_when_it_is_silent() -> None:
    robot = ScriptedLine({"ct": [None, spoiled(build_frame(6, bytes(40)))]}, N200)
    backend = direct_on(robot)
    assert robot.names().count("ct") == 3
    assert robot.calls[-1] == Call("ct", (*EVERYTHING.smask[:41], 1, *EVERYTHING.smask[42:]))
    assert backend.greeting is not None
    assert backend.greeting.slots[17] == 57
    with pytest.raises(ReplyTimeout, match="ct"):
        direct_on(ScriptedLine({"ct": None, "get_ra": None, "get_rv": None}, N200))


def test_a_n200_over_tcp_says_its_mask_first() -> None:
    robot = ScriptedLine(model=N200)
    mask = EVERYTHING.with_position(2)
    robot.wire_state.set_mask(mask)
    robot.out += build_handshake(Handshake(mask, 51))
    backend = direct_on(robot, hello=True)
    assert (backend.greeting, backend.wire_state.mask, robot.calls) == (None, mask, [])
    assert "sonar_15" in backend.execute(GS).stamps
    for few in (b"", b"\xff" * 10):
        robot = ScriptedLine(model=N200)
        robot.out += few
        with pytest.raises(ReplyTimeout, match=f"11 bytes first, and {len(few)} came; is it a n200"):
            direct_on(robot, hello=True)
        assert robot.closed == 1


@pytest.mark.parametrize(
    ("model", "name", "args", "why"),
    [
        (N150, "tk", ("hello",), "a n150 does not have it"),
        (N150, "ct", EVERYTHING.smask, "a n150 does not have it"),
        (SCOUT, "get_cp", (), "a scout does not have it"),
        (N200, "conf_ser", (1, 9600), "a n200 does not have it"),
        (N150, "real_robot", (), "only on an Nserver"),
        (N150, "draw_line", (0, 0, 1, 1, 1), "only on an Nserver"),
        (N150, "sim_truth", (), "only on an Nserver"),
        (N150, "connect_robot", (2, 1), "only on an Nserver"),
    ],
)
def test_what_the_line_does_not_have_is_refused_and_not_sent(
    model: Model, name: str, args: tuple[Any, ...], why: str
) -> None:
    robot = ScriptedLine(model=model)
    backend = direct_on(robot)
    robot.calls.clear()
    with pytest.raises(RobotRefused, match=why) as refusal:
        backend.execute(Call(name, args))
    assert refusal.value.code is None
    assert not refusal.value.is_nak
    assert robot.calls == []


def test_every_command_of_the_table_is_answered_or_refused() -> None:
    for model in (N150, N200, SCOUT):
        robot = ScriptedLine(model=model)
        backend = direct_on(robot)
        robot.calls.clear()
        for row in BY_NAME.values():
            args = {"tk": ("x",), "ct": EVERYTHING.smask}.get(row.name, (0,) * max(1, len(row.arguments)))
            args = args if row.arguments or row.name in ("ct", "tk") else ()
            if row.line_type is not None and model.name in row.line_models:
                assert backend.execute(Call(row.name, args)).kind == row.line_reply.kind
                assert BY_NAME[robot.calls[-1].name].line_type == row.line_type
            elif row.name not in ("place_robot", "disconnect_robot"):
                with pytest.raises(RobotRefused):
                    backend.execute(Call(row.name, args))


def test_place_robot_is_dp_and_da() -> None:
    robot = ScriptedLine()
    assert direct_on(robot).execute(Call("place_robot", (100, 200, 900, 450))).kind == "state"
    assert robot.calls == [Call("dp", (100, 200)), Call("da", (900, 450))]


def test_what_cannot_be_sent_is_not_sent() -> None:
    robot = ScriptedLine()
    backend = direct_on(robot)
    for call in (Call("vm", (40000, 0, 0)), Call("vm", (1,)), Call("nonsense")):
        with pytest.raises(WireError):
            backend.execute(call)
    assert robot.calls == []
    assert backend.execute(GS).kind == "state"


def test_a_nak_is_a_refusal_and_the_conversation_goes_on() -> None:
    robot = ScriptedLine({"vm": NAK})
    backend = direct_on(robot)
    with pytest.raises(RobotRefused, match="vm was refused: NAK") as refusal:
        backend.execute(VM)
    assert refusal.value.is_nak
    assert backend.execute(GS).kind == "state"
    assert backend.link.naks == 1
    assert backend.link.answers == 2


def test_a_nak_to_what_shapes_answers_leaves_their_shape() -> None:
    robot = ScriptedLine({"ct": [robot_state(N200), NAK], "conf_ls": NAK}, N200)
    backend = direct_on(robot)
    wanted = EVERYTHING.with_position(2)
    for call in (Call("ct", wanted.smask), Call("conf_ls", (33, 20, 20, 20, 4))):
        with pytest.raises(RobotRefused):
            backend.execute(call)
    assert backend.wire_state.mask == EVERYTHING
    assert backend.wire_state.laser_mode == 51
    robot.calls.clear()
    assert backend.execute(GS).kind == "state"
    assert robot.names() == ["gs"]


def robot_state(model: Model) -> Reply:
    reply: Reply = ScriptedLine(model=model).state()
    return reply


# silence, and what is no answer


def test_silence_is_a_time_out_and_the_conversation_goes_on() -> None:
    robot = ScriptedLine({"vm": None})
    backend = direct_on(robot)
    with pytest.raises(ReplyTimeout, match="vm: no answer within 1 s"):
        backend.execute(VM)
    assert not backend.closed
    assert backend.execute(GS).kind == "state"
    assert robot.names() == ["vm", "gs"]
    assert backend.link.timeouts == 1


def test_a_late_answer_of_another_type_is_dropped() -> None:
    robot = ScriptedLine({"vm": [Late()]})
    backend = direct_on(robot)
    with pytest.raises(ReplyTimeout):
        backend.execute(VM)
    robot.slots[17] = 7
    assert backend.execute(GS).slots[17] == 7
    assert backend.link.strays == 1


def test_a_late_answer_of_the_same_type_is_seen_off_by_a_question_of_another() -> None:
    robot = ScriptedLine({"gs": [Late()]})
    backend = direct_on(robot)
    with pytest.raises(ReplyTimeout):
        backend.execute(GS)
    robot.slots[17] = 7
    assert backend.execute(GS).slots[17] == 7
    assert robot.names() == ["gs", "get_ra", "gs"]
    assert backend.execute(GS).slots[17] == 7
    assert robot.names() == ["gs", "get_ra", "gs", "gs"]


def test_a_late_answer_that_has_come_before_the_next_command_needs_no_question() -> None:
    robot = ScriptedLine({"gs": [None]})
    backend = direct_on(robot)
    with pytest.raises(ReplyTimeout):
        backend.execute(GS)
    robot.out += robot.frame("gs")
    robot.slots[17] = 7
    assert backend.execute(GS).slots[17] == 7
    assert robot.names() == ["gs", "gs"]


def test_what_is_not_repeated_is_held_back_while_a_late_answer_could_pass_for_its_own() -> None:
    robot = ScriptedLine({"pr": [None], "get_ra": [None]})
    backend = direct_on(robot)
    move = Call("pr", (100, 0, 0))
    with pytest.raises(ReplyTimeout, match="pr: no answer"):
        backend.execute(move)
    with pytest.raises(ReplyTimeout, match="pr was not sent"):
        backend.execute(move)
    assert robot.names() == ["pr", "get_ra"]
    assert backend.execute(move).kind == "state"
    assert robot.names() == ["pr", "get_ra", "get_rv", "pr"]


def test_a_stop_goes_out_at_once_whatever_is_owed() -> None:
    robot = ScriptedLine({"st": [None]})
    backend = direct_on(robot)
    with pytest.raises(ReplyTimeout):
        backend.execute(ST)
    robot.slots[17] = 7
    assert backend.execute(ST).slots[17] == 7
    assert robot.names() == ["st", "st", "get_ra", "st"]


def test_when_every_question_is_owed_only_quiet_helps() -> None:
    mute: dict[str, Any] = {name: [None] for name in ("gs", "get_ra", "get_rv", "get_rc", "get_bp", "get_sn")}
    robot = ScriptedLine(mute)
    backend = direct_on(robot)
    for _ in range(6):
        with pytest.raises(ReplyTimeout):
            backend.execute(GS)
    robot.calls.clear()
    robot.slots[17] = 7
    assert backend.execute(GS).slots[17] == 7
    assert robot.names() == ["gs"]


def test_a_line_that_is_never_quiet(monkeypatch: pytest.MonkeyPatch) -> None:
    mute: dict[str, Any] = dict.fromkeys(("gs", "get_ra", "get_rv", "get_rc", "get_bp", "get_sn"))
    robot = ScriptedLine(mute)
    backend = direct_on(robot)
    for _ in range(6):
        with pytest.raises(ReplyTimeout):
            backend.execute(GS)
    monkeypatch.setattr(robot, "receive", lambda: b"\x55")
    monkeypatch.setattr("nclient.backends.direct.MAX_DRAIN_S", 0.05)
    with pytest.raises(ReplyTimeout, match="never quiet"):
        backend.execute(GS)


def test_a_nak_is_nobodys_while_others_are_owed() -> None:
    robot = ScriptedLine({"vm": [None], "gs": NAK})
    backend = direct_on(robot)
    with pytest.raises(ReplyTimeout):
        backend.execute(VM)
    with pytest.raises(ReplyTimeout, match="gs: no answer"):
        backend.execute(GS)


@pytest.mark.parametrize("position", range(48))
def test_one_wrong_byte_anywhere_is_a_bad_answer_and_nothing_else(position: int) -> None:
    robot = ScriptedLine()
    for good_before in (0, 2):
        robot.answers["gs"] = [*[robot.state()] * good_before, spoiled(robot.frame("gs"), position)]
        backend = direct_on(robot)
        for _ in range(good_before):
            backend.execute(GS)
        with pytest.raises(ReplyTimeout, match="gs: "):
            backend.execute(GS)
        assert backend.execute(RV).kind == "velocity"
        assert backend.execute(GS).slots[17] == 57


def test_stray_bytes_before_and_behind_an_answer_do_no_harm() -> None:
    robot = ScriptedLine()
    for noise in (b"\x01", b"\x00\xff", b"\x01\x00\x01", b"\x5c\x01\x05\x00"):
        robot.answers["gs"] = [noise + robot.frame("gs"), robot.frame("gs") + noise]
        backend = direct_on(robot)
        assert backend.execute(GS).slots[17] == 57
        assert backend.execute(GS).slots[17] == 57
        assert backend.execute(GS).slots[17] == 57


def test_a_length_that_hides_the_answer_is_given_up_at_the_gap() -> None:
    robot = ScriptedLine()
    robot.answers["gs"] = [b"\x01\x00\x10" + robot.frame("gs")]
    backend = direct_on(robot)
    assert backend.execute(GS).slots[17] == 57
    assert backend.link.skipped_bytes == 3


def test_a_good_frame_that_does_not_fit_is_no_answer() -> None:
    robot = ScriptedLine({"gs": [build_frame(7, bytes(41))], "vm": [build_frame(99)]})
    backend = direct_on(robot)
    with pytest.raises(ReplyTimeout, match="gs: the reply does not fit"):
        backend.execute(GS)
    with pytest.raises(ReplyTimeout, match="vm: no answer"):
        backend.execute(VM)
    assert (backend.link.misfits, backend.link.strays) == (1, 1)
    assert backend.execute(GS).kind == "state"


def test_what_cannot_be_true_is_no_answer() -> None:
    robot = ScriptedLine()
    backend = direct_on(robot)
    backend.execute(GS)
    robot.answers["gs"] = [Reply("state", {**robot.slots, 36: 3600}, clock=5000, volts=robot.volts)]
    with pytest.raises(ReplyTimeout, match=r"gs: the answer cannot be true, steering reads 3600.*checks=0"):
        backend.execute(GS)
    assert (backend.link.implausible, backend.link.timeouts) == (1, 1)
    assert backend.execute(GS).slots[36] == 0


# the shape of answers


def test_a_mask_that_was_not_answered_is_sent_again_before_anything_else() -> None:
    robot = ScriptedLine(model=N200)
    backend = direct_on(robot)
    robot.answers["ct"] = [None]
    wanted = EVERYTHING.with_position(2)
    with pytest.raises(ReplyTimeout):
        backend.execute(Call("ct", wanted.smask))
    robot.calls.clear()
    assert "sonar_3" in backend.execute(GS).stamps
    assert robot.names() == ["get_ra", "ct", "gs"]
    assert backend.execute(GS).stamps
    assert robot.names() == ["get_ra", "ct", "gs", "gs"]


def test_a_robot_that_was_switched_off_and_on_gets_its_mask_again() -> None:
    robot = ScriptedLine(model=N200)
    backend = direct_on(robot)
    backend.execute(Call("ct", EVERYTHING.with_position(2).smask))
    backend.execute(Call("conf_ls", (33, 20, 20, 20, 4)))
    robot.wire_state = serial_wire_state(N200)
    with pytest.raises(ReplyTimeout, match="does not fit"):
        backend.execute(GS)
    robot.calls.clear()
    assert "sonar_3" in backend.execute(GS).stamps
    assert [name for name in robot.names() if name != "get_ra"] == ["ct", "conf_ls", "gs"]


# time


class Patience(MemoryStream):
    """Notes how long each answer may take."""

    waits: list[float]

    def receive(self, deadline: Deadline) -> bytes:
        if deadline.remaining():
            self.waits.append(deadline.remaining())
        return super().receive(deadline)


@pytest.mark.parametrize(
    ("call", "timeout_s", "patience_s"),
    [
        (GS, None, 1.0), (GS, 0.3, 0.3), (Call("zr"), None, 120.0), (Call("zr"), 200.0, 200.0),
        (Call("ws", (1, 1, 1, 7)), None, 8.0), (Call("ws", (1, 1, 1, 7)), 3.0, 10.0),
        (Call("special_request", (9, 1)), None, 30.0),
    ],
)  # fmt: skip
def test_how_long_a_command_may_take(call: Call, timeout_s: float | None, patience_s: float) -> None:
    stream = Patience(ScriptedLine())
    stream.waits = []
    DirectBackend(stream, N150, timeout_s=timeout_s).execute(call)
    assert stream.waits == [pytest.approx(patience_s, abs=0.1)]


def test_latencies_by_a_clock_that_is_handed_in() -> None:
    robot = ScriptedLine()
    backend = DirectBackend(MemoryStream(robot), N150, clock=lambda: robot.clock / 64)
    backend.execute(GS)
    assert backend.link.longest_s == 0.25


def test_deadlines_of_a_clock_that_is_handed_in() -> None:
    simulated_s = 100.0

    class Silent(MemoryStream):
        def receive(self, deadline: Deadline) -> bytes:
            nonlocal simulated_s
            simulated_s += deadline.remaining()
            return super().receive(deadline)

    robot = ScriptedLine({"gs": None})
    backend = DirectBackend(Silent(robot), N150, clock=lambda: simulated_s)
    with pytest.raises(ReplyTimeout, match="within 1 s"):
        backend.execute(GS)
    assert simulated_s == 101.0


# the end


def test_a_stream_that_ends_closes_and_says_why() -> None:
    robot = ScriptedLine()
    stream = MemoryStream(robot)
    backend = DirectBackend(stream, N150)
    stream.close()
    with pytest.raises(ConnectionLost, match="gs: this end has closed"):
        backend.execute(GS)
    assert backend.closed
    with pytest.raises(ConnectionLost, match="connect again"):
        backend.execute(GS)


def test_closing() -> None:
    robot = ScriptedLine()
    backend = direct_on(robot)
    assert backend.execute(Call("disconnect_robot", (1, 1))).kind == "none"
    backend.close()
    assert (backend.closed, robot.closed, robot.calls) == (True, 1, [])


class Interrupted(MemoryStream):
    """A stream during which somebody presses Ctrl-C."""

    armed = False

    def receive(self, deadline: Deadline) -> bytes:
        if self.armed and deadline.remaining():
            raise KeyboardInterrupt
        return super().receive(deadline)


def test_after_an_interrupted_wait_the_robot_can_be_stopped_and_no_answer_is_mixed_up() -> None:
    robot = ScriptedLine()
    stream = Interrupted(robot)
    backend = DirectBackend(stream, N150)
    stream.armed = True
    for call in (VM, GS):
        with pytest.raises(KeyboardInterrupt):
            backend.execute(call)
    stream.armed = False
    robot.slots[17] = 7
    assert backend.execute(ST).slots[17] == 7
    assert backend.execute(GS).slots[17] == 7


# anything at all


class Careless(MemoryStream):
    """A line that drops, spoils, delays and doubts, by a seeded chance."""

    def __init__(self, robot: ScriptedLine, seed: int) -> None:
        super().__init__(robot)
        self._rng = random.Random(seed)
        self._held = b""

    def receive(self, deadline: Deadline) -> bytes:
        """In order, as on any line; what is held comes within the time that a host waits for quiet."""
        try:
            self._held += self._spoiled(super().receive(deadline))
        except ReplyTimeout:
            if not self._held or deadline.remaining() < QUIET_S / 2:
                raise
        if self._rng.random() < 0.1:
            raise ReplyTimeout("held")
        data, self._held = self._held, b""
        return data

    def _spoiled(self, data: bytes) -> bytes:
        fate, at = self._rng.random(), self._rng.randrange(len(data))
        if fate < 0.1:
            data = spoiled(data, at)
        elif fate < 0.2:
            data = data[:at] + data[at + 1 :]
        return data


@pytest.mark.parametrize("seed", range(8))
def test_no_late_and_no_corrupt_answer_is_ever_another_commands(seed: int) -> None:
    robot = ScriptedLine()
    backend = DirectBackend(Careless(robot, seed), N150)
    answered = 0
    for number in range(400):
        robot.slots[34] = number % 50
        name = ("gs", "get_rc", "st", "gs")[number % 4]
        try:
            reply = backend.execute(Call(name))
        except ReplyTimeout:
            continue
        assert reply.slots[34] == number % 50
        answered += 1
    assert answered > 120


@pytest.mark.parametrize("laser", [(0,), (2, 10, 20, 30, -40, 50, 60, 70, -80)])
def test_a_laser_that_another_client_left_in_line_mode_is_read(laser: tuple[int, ...]) -> None:
    robot = ScriptedLine(model=N200)
    robot.wire_state.set_laser_mode(33)
    robot.laser = laser
    backend = direct_on(robot)
    assert backend.greeting is not None
    assert backend.greeting.laser == laser
    robot.laser = (1, 1, 2, 3, -4)
    assert backend.execute(GS).laser == (1, 1, 2, 3, -4)
    robot.wire_state.set_laser_mode(51)
    robot.laser = (3, 100, 200, 300)
    assert backend.execute(GS).laser == (3, 100, 200, 300)


def test_a_laser_mode_that_was_said_is_the_mode() -> None:
    robot = ScriptedLine(model=N200)
    backend = direct_on(robot)
    backend.execute(Call("conf_ls", (51, 20, 20, 60, 4)))
    robot.wire_state.set_laser_mode(33)
    robot.laser = (1, 1, 2, 3, -4)
    with pytest.raises(ReplyTimeout, match="does not fit"):
        backend.execute(GS)
    robot = ScriptedLine(model=N200)
    robot.out += build_handshake(Handshake(EVERYTHING, 51))
    backend = direct_on(robot, hello=True)
    robot.wire_state.set_laser_mode(33)
    robot.laser = (1, 1, 2, 3, -4)
    with pytest.raises(ReplyTimeout, match="does not fit"):
        backend.execute(GS)


@pytest.mark.parametrize(("real", "said", "remedy"), [
    (N200, N150, "it looks like a n200's: write model=n200"), (N200, SCOUT, "it looks like a n200's: write model=n200"),
    (SCOUT, N150, "is it a n150. Else write model=n200 or model=scout"),
    (N150, SCOUT, "is it a scout. Else write model=n150 or model=n200"),
])
def test_another_model_than_was_said_is_told_from_the_first_answer_on(real: Model, said: Model, remedy: str) -> None:
    robot = ScriptedLine(model=real)
    backend = RetryingBackend(DirectBackend(MemoryStream(robot), said), 2)
    for _ in range(3):
        with pytest.raises(ReplyTimeout, match=remedy):
            backend.execute(Call("conf_tm", (5,)))


def test_what_is_understood_once_is_of_this_model() -> None:
    robot = ScriptedLine()
    backend = direct_on(robot)
    backend.execute(GS)
    robot.answers["gs"] = build_frame(7, ScriptedLine(model=N200).frame("gs")[4:-2])
    with pytest.raises(ReplyTimeout, match="does not fit") as failed:
        backend.execute(GS)
    assert "model=" not in str(failed.value)


def test_no_n200_at_the_other_end_of_a_mask() -> None:
    with pytest.raises(ReplyTimeout, match=r"no answer within 1 s; is it a n200. Else write model=n150 or model=scout"):
        direct_on(ScriptedLine({"ct": None}, N200))
    with pytest.raises(RobotRefused, match=r"ct was refused: NAK; is it a n200. Else write model=n150 or model=scout"):
        direct_on(ScriptedLine({"ct": NAK_FRAME}, N200))
    with pytest.raises(ReplyTimeout, match=r"sends 11 bytes first, and 0 came; is it a n200. Else write model="):
        direct_on(ScriptedLine(model=N200), hello=True)
