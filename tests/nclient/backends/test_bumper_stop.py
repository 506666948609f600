"""A bumper hit stops the robot at once and raises BumperHit; a robot at a wall can leave it."""

from __future__ import annotations

import pickle

import pytest

from nclient.backends.base import Backend, KeepAlive
from nclient.backends.wrappers import BumperStop
from nclient.errors import BumperHit
from nclient.protocol.commands import Call
from nclient.protocol.types import N150, N200, SCOUT, Model
from tests.nclient.scripted_line import Answer, ScriptedLine, direct_on

GS, VM = Call("gs"), Call("vm", (100, 0, 0))


@pytest.mark.parametrize("model", [N150, N200, SCOUT])
def test_a_hit_while_moving_sends_st_and_raises(model: Model) -> None:
    robot = ScriptedLine(model=model)
    backend = BumperStop(direct_on(robot))
    robot.calls.clear()
    # Motor bit 0: the robot drives when vm is answered.
    robot.slots[41] = 1
    backend.execute(VM)
    # Bumpers 0 and 2 close during the motion.
    robot.slots[33] |= 0b101
    with pytest.raises(BumperHit, match="bumper 0, 2 closed") as hit:
        backend.execute(GS)
    assert (hit.value.command, hit.value.bumpers) == ("gs", (0, 2))
    assert robot.names() == ["vm", "gs", "st"]


# Contact ends the motion before the reply: motor bits 0 and a closed bumper in the same reply.
def test_a_robot_stopped_by_the_wall_counts_as_moving() -> None:
    robot = ScriptedLine()
    backend = BumperStop(direct_on(robot))
    # 1. The first reply after the motion command shows the contact.
    robot.slots[33] |= 1
    with pytest.raises(BumperHit):
        backend.execute(VM)
    # 2. The contact appears in get_bp, which carries no motor bits.
    robot = ScriptedLine()
    backend = BumperStop(direct_on(robot))
    robot.slots[41] = 1
    backend.execute(VM)
    robot.slots[41] = 0
    robot.slots[33] |= 1
    with pytest.raises(BumperHit):
        backend.execute(Call("get_bp"))


def test_a_robot_can_leave_the_wall() -> None:
    # 1. Contact: bumper 0.
    robot = ScriptedLine()
    backend = BumperStop(direct_on(robot))
    robot.slots[33] |= 1
    with pytest.raises(BumperHit):
        backend.execute(VM)
    # 2. The robot leaves with bumper 0 still closed: no second exception for the same contact.
    robot.slots[41] = 1
    backend.execute(Call("vm", (-100, 0, 0)))
    # 3. Another bumper is a new contact.
    robot.slots[33] |= 1 << 10
    with pytest.raises(BumperHit, match="bumper 10"):
        backend.execute(GS)
    # 4. All bumpers open: the next contact of bumper 0 counts again.
    robot.slots[33] = N150.bumper_rest
    backend.execute(GS)
    robot.slots[41] = 1
    backend.execute(VM)
    robot.slots[33] |= 1
    with pytest.raises(BumperHit, match="bumper 0"):
        backend.execute(GS)


def test_pushing_a_robot_at_rest_stops_nothing() -> None:
    robot = ScriptedLine()
    backend = BumperStop(direct_on(robot))
    # The motor bits of the last reply are 0.
    backend.execute(GS)
    robot.slots[33] |= 1
    backend.execute(GS)
    assert backend.execute(Call("get_rc")).kind == "configuration"
    assert robot.names() == ["gs", "gs", "get_rc"]


def test_bumpers_closed_on_connecting_do_not_count() -> None:
    robot = ScriptedLine(model=N200)
    robot.slots[33] |= 1
    backend = BumperStop(direct_on(robot))
    # Bumper 0 was already closed when the session began.
    robot.slots[41] = 1
    assert backend.execute(VM).slots[33] & 1


def test_st_is_repeated_until_it_is_answered() -> None:
    silences: list[Answer] = [None, None]
    robot = ScriptedLine({"st": silences})
    backend = BumperStop(direct_on(robot))
    robot.slots[33] |= 1
    with pytest.raises(BumperHit):
        backend.execute(VM)
    # Two lost replies: st is sent until one arrives.
    assert robot.names().count("st") >= 3
    # A robot that answers nothing, not even the probes: the hit is reported nevertheless.
    robot = ScriptedLine({"st": None, "get_ra": None, "get_rv": None})
    backend = BumperStop(direct_on(robot))
    robot.slots[33] |= 1
    with pytest.raises(BumperHit):
        backend.execute(VM)


def test_bumper_hit_can_be_pickled() -> None:
    hit = pickle.loads(pickle.dumps(BumperHit("vm", (3, 4))))
    assert (hit.command, hit.bumpers, str(hit)) == ("vm", (3, 4), str(BumperHit("vm", (3, 4))))


# Without a keep-alive, with one that splits ws at half its timeout of 5 s, and with one that would not split it.
@pytest.mark.parametrize("timeout_s", [0, 5, 60])
def test_a_hit_during_ws_is_noticed_within_a_second(timeout_s: int) -> None:
    rolling = ScriptedLine()
    rolling.slots[41] = 1
    # The clock of the scripted replies must not run back.
    rolling.clock = 1050
    answers: list[Answer] = [rolling.state(), rolling.state()]
    rolling.slots[33] |= 1 << 3
    answers.append(rolling.state())
    robot = ScriptedLine({"ws": answers})
    backend: Backend = BumperStop(direct_on(robot))
    if timeout_s:
        backend = KeepAlive(backend, timeout_s, feeds=False)
    robot.calls.clear()
    backend.execute(VM)
    with pytest.raises(BumperHit, match="ws: bumper 3"):
        backend.execute(Call("ws", (1, 0, 0, 30)))
    # The wait of 30 s is sent in pieces of 1 s; the third reply shows the bumper.
    assert robot.calls[1:] == [Call("ws", (1, 0, 0, 1))] * 3 + [Call("st")]
