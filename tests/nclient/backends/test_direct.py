"""The direct backend returns the reply of the right command on an unreliable line, and the session continues."""

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
from nclient.protocol.types import EVERYTHING, N150, N200, SCOUT, Model, serial_wire_state
from nclient.transports.stream import Deadline, MemoryStream
from tests.nclient.protocol.recorded import LINE_SESSIONS, model_of
from tests.nclient.scripted_line import NAK, Late, RecordedRobot, ScriptedLine, direct_on, spoiled

GS, ST, RV = Call("gs"), Call("st"), Call("get_rv")
VM = Call("vm", (100, -50, 0))
NAK_FRAME = build_frame(8)


def test_request_and_reply() -> None:
    robot = ScriptedLine()
    backend = direct_on(robot)
    assert (backend.greeting, backend.port, backend.closed) == (None, 1, False)
    # A N150 has a fixed mask: connecting sends nothing.
    assert robot.calls == []
    robot.slots[17] = 99
    reply = backend.execute(VM)
    # 1000 ms at the start, and 16 ms for each command.
    assert (reply.kind, reply.slots[17], reply.clock) == ("state", 99, 1016)
    # vm(100, -50, 0): length 8, type 5, three int16 in sign-magnitude, checksum 0x24.
    assert robot.requests.hex() == "01080005640032800000245c"
    assert (backend.link.exchanges, backend.link.answers, backend.link.frames) == (1, 1, 1)


@pytest.mark.parametrize("session", LINE_SESSIONS)
def test_recorded_sessions_of_the_c_library(session: str) -> None:
    peer = RecordedRobot(session)
    model = model_of(session)
    backend = DirectBackend(MemoryStream(peer), model, hello=session == "n200_tcp", checks=False)
    held = ClientState()
    played = peer.exchanges
    # The recorded reply to ct is read while connecting, so that the loop begins behind it.
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
            # The C library starts with zeros, where this client stores None.
            assert [value or 0 for value in held.slots] == exchange.decoded["State"], exchange.call
    backend.close()


def test_the_mask_of_an_n200_is_repeated() -> None:
    # The first ct gets no reply, the second one a corrupt one.
    robot = ScriptedLine({"ct": [None, spoiled(build_frame(6, bytes(40)))]}, N200)
    backend = direct_on(robot)
    assert robot.names().count("ct") == 3
    # Smask[41] is not sent on the serial line: the robot reads it as 1.
    assert robot.calls[-1] == Call("ct", (*EVERYTHING.smask[:41], 1, *EVERYTHING.smask[42:]))
    assert backend.greeting is not None
    assert backend.greeting.slots[17] == 57
    with pytest.raises(ReplyTimeout, match="ct"):
        direct_on(ScriptedLine({"ct": None, "get_ra": None, "get_rv": None}, N200))


def test_an_n200_over_tcp_sends_its_mask_first() -> None:
    robot = ScriptedLine(model=N200)
    mask = EVERYTHING.with_position(2)
    robot.wire_state.set_mask(mask)
    # The robot sends its 11 bytes without a request: mask with sonar stamps, laser mode 51.
    robot.out += build_handshake(Handshake(mask, 51))
    backend = direct_on(robot, hello=True)
    assert (backend.greeting, backend.wire_state.mask, robot.calls) == (None, mask, [])
    assert "sonar_15" in backend.execute(GS).stamps
    # No byte, and one byte too few.
    for few in (b"", b"\xff" * 10):
        robot = ScriptedLine(model=N200)
        robot.out += few
        with pytest.raises(ReplyTimeout, match=f"11 bytes.* {len(few)} came.* n200"):
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
def test_commands_the_line_lacks_are_refused(
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


@pytest.mark.long
def test_every_command_is_answered_or_refused() -> None:
    for model in (N150, N200, SCOUT):
        robot = ScriptedLine(model=model)
        backend = direct_on(robot)
        robot.calls.clear()
        for row in BY_NAME.values():
            args = {"tk": ("x",), "ct": EVERYTHING.smask}.get(row.name, (0,) * max(1, len(row.arguments)))
            args = args if row.arguments or row.name in ("ct", "tk") else ()
            if row.line_type is not None and model.name in row.line_models:
                # One reply layout of the table for each command that the model has; all others are refused without a
                # request.
                assert backend.execute(Call(row.name, args)).kind == row.line_reply.kind
                assert BY_NAME[robot.calls[-1].name].line_type == row.line_type
            # place_robot is sent as dp and da, and disconnect_robot closes the line.
            elif row.name not in ("place_robot", "disconnect_robot"):
                with pytest.raises(RobotRefused):
                    backend.execute(Call(row.name, args))


def test_place_robot_is_dp_and_da() -> None:
    robot = ScriptedLine()
    assert direct_on(robot).execute(Call("place_robot", (100, 200, 900, 450))).kind == "state"
    assert robot.calls == [Call("dp", (100, 200)), Call("da", (900, 450))]


def test_invalid_calls_are_not_sent() -> None:
    robot = ScriptedLine()
    backend = direct_on(robot)
    for call in (Call("vm", (40000, 0, 0)), Call("vm", (1,)), Call("nonsense")):
        with pytest.raises(WireError):
            backend.execute(call)
    assert robot.calls == []
    assert backend.execute(GS).kind == "state"


def test_a_nak_is_a_refusal_and_the_session_continues() -> None:
    robot = ScriptedLine({"vm": NAK})
    backend = direct_on(robot)
    with pytest.raises(RobotRefused, match=r"vm .*refused.*NAK") as refusal:
        backend.execute(VM)
    assert refusal.value.is_nak
    assert backend.execute(GS).kind == "state"
    assert backend.link.naks == 1
    assert backend.link.answers == 2


def test_a_nak_reverts_the_reply_format() -> None:
    # The first ct is that of the connection; the second one and conf_ls are refused.
    robot = ScriptedLine({"ct": [robot_state(N200), NAK], "conf_ls": NAK}, N200)
    backend = direct_on(robot)
    wanted = EVERYTHING.with_position(2)
    for call in (Call("ct", wanted.smask), Call("conf_ls", (33, 20, 20, 20, 4))):
        with pytest.raises(RobotRefused):
            backend.execute(call)
    # The robot did not change the format, so that the next replies have the old one.
    assert backend.wire_state.mask == EVERYTHING
    assert backend.wire_state.laser_mode == 51
    robot.calls.clear()
    assert backend.execute(GS).kind == "state"
    assert robot.names() == ["gs"]


def robot_state(model: Model) -> Reply:
    reply: Reply = ScriptedLine(model=model).state()
    return reply


# timeouts and invalid replies


def test_a_timeout_leaves_the_session_open() -> None:
    robot = ScriptedLine({"vm": None})
    backend = direct_on(robot)
    with pytest.raises(ReplyTimeout, match=r"vm: .* 1 s"):
        backend.execute(VM)
    assert not backend.closed
    assert backend.execute(GS).kind == "state"
    assert robot.names() == ["vm", "gs"]
    assert backend.link.timeouts == 1


def test_a_late_reply_of_another_type_is_dropped() -> None:
    # The reply to vm arrives with the next command.
    robot = ScriptedLine({"vm": [Late()]})
    backend = direct_on(robot)
    with pytest.raises(ReplyTimeout):
        backend.execute(VM)
    robot.slots[17] = 7
    assert backend.execute(GS).slots[17] == 7
    # vm and gs both have state packets, but with their own frame types.
    assert backend.link.strays == 1


def test_a_late_reply_is_flushed_by_another_request() -> None:
    robot = ScriptedLine({"gs": [Late()]})
    backend = direct_on(robot)
    with pytest.raises(ReplyTimeout):
        backend.execute(GS)
    # A new value, to distinguish the late reply from the right one.
    robot.slots[17] = 7
    assert backend.execute(GS).slots[17] == 7
    # get_ra has another reply type. Once it is answered, the late reply to gs has arrived and was dropped.
    assert robot.names() == ["gs", "get_ra", "gs"]
    assert backend.execute(GS).slots[17] == 7
    assert robot.names() == ["gs", "get_ra", "gs", "gs"]


def test_a_late_reply_that_arrived_needs_no_flush() -> None:
    robot = ScriptedLine({"gs": [None]})
    backend = direct_on(robot)
    with pytest.raises(ReplyTimeout):
        backend.execute(GS)
    # The late reply arrives before the next request: clearing the input finds it.
    robot.out += robot.frame("gs")
    robot.slots[17] = 7
    assert backend.execute(GS).slots[17] == 7
    assert robot.names() == ["gs", "gs"]


# A motion must not be sent as long as a late reply could be taken for its own: it would count as executed.
def test_a_motion_waits_until_no_late_reply_can_match() -> None:
    robot = ScriptedLine({"pr": [None], "get_ra": [None]})
    backend = direct_on(robot)
    move = Call("pr", (100, 0, 0))
    with pytest.raises(ReplyTimeout, match="pr: no answer"):
        backend.execute(move)
    # The probe, get_ra, gets no reply either.
    with pytest.raises(ReplyTimeout, match=r"pr .*not sent"):
        backend.execute(move)
    assert robot.names() == ["pr", "get_ra"]
    # The next probe has another type, get_rv; its reply proves that nothing older arrives.
    assert backend.execute(move).kind == "state"
    assert robot.names() == ["pr", "get_ra", "get_rv", "pr"]


def test_a_stop_is_sent_at_once() -> None:
    robot = ScriptedLine({"st": [None]})
    backend = direct_on(robot)
    with pytest.raises(ReplyTimeout):
        backend.execute(ST)
    robot.slots[17] = 7
    assert backend.execute(ST).slots[17] == 7
    # st goes out before the probe. Its second copy, after the probe, has the reply that is returned.
    assert robot.names() == ["st", "st", "get_ra", "st"]


# All five probes are outstanding: only silence shows that no late reply arrives.
def test_the_line_is_drained_if_no_probe_is_left() -> None:
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


def test_a_line_that_never_becomes_quiet(monkeypatch: pytest.MonkeyPatch) -> None:
    mute: dict[str, Any] = dict.fromkeys(("gs", "get_ra", "get_rv", "get_rc", "get_bp", "get_sn"))
    robot = ScriptedLine(mute)
    backend = direct_on(robot)
    for _ in range(6):
        with pytest.raises(ReplyTimeout):
            backend.execute(GS)
    # A line that sends noise without end.
    monkeypatch.setattr(robot, "receive", lambda: b"\x55")
    monkeypatch.setattr("nclient.backends.direct.MAX_DRAIN_S", 0.05)
    with pytest.raises(ReplyTimeout, match="never quiet"):
        backend.execute(GS)


# A NAK does not name its command: with two requests outstanding it may belong to either.
def test_a_nak_is_ignored_while_other_replies_are_pending() -> None:
    robot = ScriptedLine({"vm": [None], "gs": NAK})
    backend = direct_on(robot)
    with pytest.raises(ReplyTimeout):
        backend.execute(VM)
    with pytest.raises(ReplyTimeout, match="gs: no answer"):
        backend.execute(GS)


# A state packet of a N150: 42 bytes of data, and 6 of the frame.
@pytest.mark.parametrize("position", range(48))
def test_one_corrupt_byte_costs_one_reply(position: int) -> None:
    robot = ScriptedLine()
    # As the first reply, and after two good ones.
    for good_before in (0, 2):
        robot.answers["gs"] = [*[robot.state()] * good_before, spoiled(robot.frame("gs"), position)]
        # A new session on the same robot, so that no fault before it has an effect.
        backend = direct_on(robot)
        for _ in range(good_before):
            backend.execute(GS)
        with pytest.raises(ReplyTimeout, match="gs: "):
            backend.execute(GS)
        assert backend.execute(RV).kind == "velocity"
        assert backend.execute(GS).slots[17] == 57


def test_stray_bytes_around_a_reply_are_skipped() -> None:
    robot = ScriptedLine()
    # A lone start byte; no start byte; the head of a frame of 260 bytes; an end byte and the head of a short frame.
    for noise in (b"\x01", b"\x00\xff", b"\x01\x00\x01", b"\x5c\x01\x05\x00"):
        robot.answers["gs"] = [noise + robot.frame("gs"), robot.frame("gs") + noise]
        backend = direct_on(robot)
        assert backend.execute(GS).slots[17] == 57
        assert backend.execute(GS).slots[17] == 57
        assert backend.execute(GS).slots[17] == 57


def test_a_corrupt_length_is_abandoned_at_the_gap() -> None:
    robot = ScriptedLine()
    # 0x1000 bytes would follow: the reply behind this head is found when the line is silent.
    robot.answers["gs"] = [b"\x01\x00\x10" + robot.frame("gs")]
    backend = direct_on(robot)
    assert backend.execute(GS).slots[17] == 57
    # Only the three bytes of the false head are lost.
    assert backend.link.skipped_bytes == 3


def test_a_valid_frame_that_does_not_fit_is_no_reply() -> None:
    # The right type with 41 instead of 42 bytes, and a type that no command has.
    robot = ScriptedLine({"gs": [build_frame(7, bytes(41))], "vm": [build_frame(99)]})
    backend = direct_on(robot)
    with pytest.raises(ReplyTimeout, match=r"gs: .*not fit"):
        backend.execute(GS)
    with pytest.raises(ReplyTimeout, match="vm: no answer"):
        backend.execute(VM)
    assert (backend.link.misfits, backend.link.strays) == (1, 1)
    assert backend.execute(GS).kind == "state"


def test_an_implausible_reply_is_rejected() -> None:
    robot = ScriptedLine()
    backend = direct_on(robot)
    backend.execute(GS)
    # Steering is 0 to 3599: the frame has a valid checksum, and its content cannot be true.
    robot.answers["gs"] = [Reply("state", {**robot.slots, 36: 3600}, clock=5000, volts=robot.volts)]
    with pytest.raises(ReplyTimeout, match=r"gs: .*steering .*3600.*checks=0"):
        backend.execute(GS)
    assert (backend.link.implausible, backend.link.timeouts) == (1, 1)
    assert backend.execute(GS).slots[36] == 0


# the format of replies


def test_an_unanswered_mask_is_sent_again_first() -> None:
    robot = ScriptedLine(model=N200)
    backend = direct_on(robot)
    robot.answers["ct"] = [None]
    wanted = EVERYTHING.with_position(2)
    with pytest.raises(ReplyTimeout):
        backend.execute(Call("ct", wanted.smask))
    robot.calls.clear()
    assert "sonar_3" in backend.execute(GS).stamps
    # ct may have had an effect or not: it is sent again before a reply must be decoded.
    assert robot.names() == ["get_ra", "ct", "gs"]
    assert backend.execute(GS).stamps
    assert robot.names() == ["get_ra", "ct", "gs", "gs"]


def test_a_restarted_robot_gets_its_mask_again() -> None:
    robot = ScriptedLine(model=N200)
    backend = direct_on(robot)
    backend.execute(Call("ct", EVERYTHING.with_position(2).smask))
    backend.execute(Call("conf_ls", (33, 20, 20, 20, 4)))
    # The robot restarts with its default mask and laser mode.
    robot.wire_state = serial_wire_state(N200)
    with pytest.raises(ReplyTimeout, match="does not fit"):
        # The reply has no stamps, and does not fit the format that was set.
        backend.execute(GS)
    robot.calls.clear()
    assert "sonar_3" in backend.execute(GS).stamps
    # Both settings are sent again, in the order in which the format needs them.
    assert [name for name in robot.names() if name != "get_ra"] == ["ct", "conf_ls", "gs"]


# time


class DeadlineRecorder(MemoryStream):
    """Record the maximum time for each reply."""

    waits: list[float]

    def receive(self, deadline: Deadline) -> bytes:
        if deadline.remaining():
            self.waits.append(deadline.remaining())
        return super().receive(deadline)


@pytest.mark.parametrize(
    ("call", "timeout_s", "timeout_limit_s"),
    [
        # 1 s for ordinary commands, 120 s for zr, 30 s for user packets; ws has its own time in addition.
        (GS, None, 1.0), (GS, 0.3, 0.3), (Call("zr"), None, 120.0), (Call("zr"), 200.0, 200.0),
        (Call("ws", (1, 1, 1, 7)), None, 8.0), (Call("ws", (1, 1, 1, 7)), 3.0, 10.0),
        (Call("special_request", (9, 1)), None, 30.0),
    ],
)  # fmt: skip
def test_timeouts_depend_on_the_command(call: Call, timeout_s: float | None, timeout_limit_s: float) -> None:
    stream = DeadlineRecorder(ScriptedLine())
    stream.waits = []
    DirectBackend(stream, N150, timeout_s=timeout_s).execute(call)
    assert stream.waits == [pytest.approx(timeout_limit_s, abs=0.1)]


def test_latencies_use_the_given_clock() -> None:
    robot = ScriptedLine()
    backend = DirectBackend(MemoryStream(robot), N150, clock=lambda: robot.clock / 64)
    backend.execute(GS)
    # The scripted clock advances by 16 ms for each command: 16 / 64 = 0.25.
    assert backend.link.longest_s == 0.25


# In a simulation a deadline is simulated time: nothing waits in real time.
def test_deadlines_use_the_given_clock() -> None:
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


def test_a_closed_stream_ends_the_session() -> None:
    robot = ScriptedLine()
    stream = MemoryStream(robot)
    backend = DirectBackend(stream, N150)
    stream.close()
    with pytest.raises(ConnectionLost, match="gs: this end"):
        backend.execute(GS)
    assert backend.closed
    with pytest.raises(ConnectionLost, match="connect again"):
        backend.execute(GS)


def test_closing() -> None:
    robot = ScriptedLine()
    # disconnect_robot is a message of Nserver's protocol: a serial line is just closed.
    backend = direct_on(robot)
    assert backend.execute(Call("disconnect_robot", (1, 1))).kind == "none"
    backend.close()
    assert (backend.closed, robot.closed, robot.calls) == (True, 1, [])


class Interrupted(MemoryStream):
    """A stream that is interrupted by Ctrl-C."""

    armed = False

    def receive(self, deadline: Deadline) -> bytes:
        if self.armed and deadline.remaining():
            raise KeyboardInterrupt
        return super().receive(deadline)


def test_a_robot_can_be_stopped_after_ctrl_c() -> None:
    robot = ScriptedLine()
    stream = Interrupted(robot)
    backend = DirectBackend(stream, N150)
    # Ctrl-C during the wait for each reply: both replies are still outstanding.
    stream.armed = True
    for call in (VM, GS):
        with pytest.raises(KeyboardInterrupt):
            backend.execute(call)
    stream.armed = False
    robot.slots[17] = 7
    # The replies to vm and gs must not be taken for those of st and the second gs.
    assert backend.execute(ST).slots[17] == 7
    assert backend.execute(GS).slots[17] == 7


# random faults


class UnreliableStream(MemoryStream):
    """A line that drops, corrupts and delays bytes at random, with a seed."""

    def __init__(self, robot: ScriptedLine, seed: int) -> None:
        super().__init__(robot)
        self._rng = random.Random(seed)
        self._held = b""

    def receive(self, deadline: Deadline) -> bytes:
        """Receive in order, as on any line; delayed bytes arrive before a host stops draining."""
        try:
            self._held += self._spoiled(super().receive(deadline))
        except ReplyTimeout:
            # A host drains the line for QUIET_S; delayed bytes must arrive within it, as the protocol assumes.
            if not self._held or deadline.remaining() < QUIET_S / 2:
                raise
        if self._rng.random() < 0.1:
            raise ReplyTimeout("held")
        data, self._held = self._held, b""
        return data

    def _spoiled(self, data: bytes) -> bytes:
        # One chunk in ten has a wrong byte, one in ten lacks a byte; some are delayed.
        fate, at = self._rng.random(), self._rng.randrange(len(data))
        if fate < 0.1:
            data = spoiled(data, at)
        elif fate < 0.2:
            data = data[:at] + data[at + 1 :]
        return data


@pytest.mark.long
@pytest.mark.parametrize("seed", range(8))
def test_replies_on_an_unreliable_line_are_never_confused(seed: int) -> None:
    robot = ScriptedLine()
    backend = DirectBackend(UnreliableStream(robot, seed), N150)
    answered = 0
    for number in range(400):
        # x changes with each request: a late reply shows an older value.
        robot.slots[34] = number % 50
        name = ("gs", "get_rc", "st", "gs")[number % 4]
        try:
            reply = backend.execute(Call(name))
        except ReplyTimeout:
            continue
        # The one property: a reply is that of this request, or there is none.
        assert reply.slots[34] == number % 50
        answered += 1
    # Without a minimum a backend that never returns a reply would pass.
    assert answered > 120


@pytest.mark.parametrize("laser", [(0,), (2, 10, 20, 30, -40, 50, 60, 70, -80)])
# Lines have four numbers a reading, pixels one: the length of the first reply shows the mode.
def test_a_laser_left_in_line_mode_is_decoded(laser: tuple[int, ...]) -> None:
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


# After conf_ls, or a handshake, another mode is a fault of the line or of the robot, and not a guess.
def test_a_laser_mode_that_was_set_is_certain() -> None:
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


@pytest.mark.parametrize(("real", "named", "remedy"), [
    (N200, N150, "it looks like a n200's: write model=n200"), (N200, SCOUT, "it looks like a n200's: write model=n200"),
    (SCOUT, N150, "is it a n150. Else write model=n200 or model=scout"),
    (N150, SCOUT, "is it a scout. Else write model=n150 or model=n200"),
])
def test_a_wrong_model_is_reported_at_the_first_reply(real: Model, named: Model, remedy: str) -> None:
    robot = ScriptedLine(model=real)
    # conf_tm is retried: the hint must be in the error of each attempt.
    backend = RetryingBackend(DirectBackend(MemoryStream(robot), named), 2)
    for _ in range(3):
        with pytest.raises(ReplyTimeout, match=remedy):
            backend.execute(Call("conf_tm", (5,)))


def test_no_model_hint_after_a_valid_reply() -> None:
    robot = ScriptedLine()
    backend = direct_on(robot)
    backend.execute(GS)
    # A state packet of a N200 in the middle of a session with a N150 is corrupt data, and no wrong address.
    robot.answers["gs"] = build_frame(7, ScriptedLine(model=N200).frame("gs")[4:-2])
    with pytest.raises(ReplyTimeout, match="does not fit") as failed:
        backend.execute(GS)
    assert "model=" not in str(failed.value)


def test_a_missing_n200_is_reported_with_a_hint() -> None:
    with pytest.raises(ReplyTimeout, match=r" 1 s.* n200.*model=n150.*model=scout"):
        direct_on(ScriptedLine({"ct": None}, N200))
    with pytest.raises(RobotRefused, match=r"ct .*NAK.* n200.*model=n150.*model=scout"):
        direct_on(ScriptedLine({"ct": NAK_FRAME}, N200))
    with pytest.raises(ReplyTimeout, match=r"11 bytes.* 0 came.* n200.*model="):
        direct_on(ScriptedLine(model=N200), hello=True)
