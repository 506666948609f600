"""A class: the class file, its links, and what a student's page may do."""

from __future__ import annotations

import argparse
import asyncio
import json
import math
from collections.abc import Iterator
from contextlib import AsyncExitStack
from pathlib import Path
from typing import Any

import pytest
from aiohttp import WSServerHandshakeError

from nclient.protocol import codec
from nclient.protocol.commands import Call
from nserver_emu.cli import nserver_parser, read_options
from nserver_emu.server.admission import Limits
from nserver_emu.server.config import ROOM_AHEAD_IN, SimulationConfig, has_room_ahead, robot_placements
from nserver_emu.server.daemon import Daemon
from nserver_emu.server.handlers.table import Emulator
from nserver_emu.simulation.models import N150
from nserver_emu.simulation.noise import IDEAL
from nserver_emu.viewer.classroom import ClassFileError, Student, links_path, read_class, write_links
from nserver_emu.viewer.http_port import Access
from nserver_emu.viewer.options import require_robots
from nserver_emu.viewer.server import ViewerServer
from tests.nserver_emu.server.wire_client import simulation
from tests.nserver_emu.viewer.page_client import HOST, Message, Page, serve_viewer
from tests.nserver_emu.viewer.test_localization import GOOD
from worlds.world import StartPose

ADA, BOB = "a" * 20, "b" * 20
STUDENTS = [Student("Ada", ADA, 1), Student("Bob", BOB, 2)]


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "students.csv"


def write(path: Path, text: str) -> Path:
    path.write_text(text)
    path.chmod(0o600)
    return path


def test_students_get_free_robots_and_tokens(path: Path) -> None:
    # Robots 2, 5 and 4 are given; the others get the lowest free numbers, 1 and 3.
    text = f'Name,robot\n# a comment\n"Lovelace, Ada",{ADA},2\n\nBob\nGrace,,5\nAlan,4\nKay,{BOB}\n'
    students = read_class(write(path, text))
    assert [(name, robot) for name, _, robot in students] == [
        ("Lovelace, Ada", 2), ("Bob", 1), ("Grace", 5), ("Alan", 4), ("Kay", 3)]
    assert (students[0].token, students[4].token) == (ADA, BOB)
    assert len({token for _, token, _ in students}) == 5
    # At least 16 characters: hard to guess.
    assert min(len(token) for _, token, _ in students) >= 16


def test_links_are_private_and_stay_over_restarts(path: Path) -> None:
    students = read_class(write(path, "Ada\nBob\n"))
    links = write_links(path, students, "http://lab:7080", "nserver://lab:7019")
    assert links == links_path(path) == path.with_name("students.links.csv")
    assert links.stat().st_mode & 0o777 == 0o600
    assert links.read_text().splitlines()[1] == (
        f"Ada,1,{students[0].token},http://lab:7080/?token={students[0].token},nserver://lab:7019/1")
    # The order of lines may change, and a new student has a new token.
    again = read_class(write(path, "Eve\nBob\nAda\n"))
    assert [again[2].token, again[1].token] == [student.token for student in students]
    # A file that others may read could have been changed: its tokens are not used again.
    links.chmod(0o644)
    assert read_class(path)[2].token != students[0].token


@pytest.mark.parametrize(("text", "line", "remedy"), [
    ("", "students.csv:", "write a line"),
    ("name\n", "students.csv:", "write a line"),
    ("Ada\nBob,short\n", "line 2:", "leave it out"),
    ("Ada,,0\n", "line 1:", "leave it out"),
    ("Ada,,1001\n", "line 1:", "1 to 1000"),
    ("Ada,,x\n", "line 1:", "'x'"),
    ("Ada\n\nada\n", "line 3:", "line 1 already"),
    ("Ada,,3\nBob,,3\n", "line 2:", "robot 3"),
    (f"Ada,{ADA}\nBob,{ADA}\n", "line 2:", "this token"),
    ("Ada,,1,2\n", "line 1:", "quotes"),
    (",x\n", "line 1:", "1 to 40"),
    # A spreadsheet would take such a name for a formula.
    ("=1+2\n", "line 1:", "= + - @"),
    ("Ada;7\n", "line 1:", "commas"),
    ("name\nTeacher\n", "line 2:", "another"),
    pytest.param(f"Ada,,{'9' * 5000}\n", "line 1:", "1 to 1000", id="digits"),
    pytest.param("\n".join(f"S{number}" for number in range(1001)), "students.csv:", "at most 1000", id="many"),
    ('"Ada\n', "line 1", "name"),
])  # fmt: skip
def test_error_names_line_and_remedy(path: Path, text: str, line: str, remedy: str) -> None:
    with pytest.raises(ClassFileError) as error:
        read_class(write(path, text))
    assert line in str(error.value)
    assert remedy in str(error.value)


def test_tokens_that_others_may_read_are_refused(path: Path) -> None:
    write(path, f"Ada,{ADA}\n").chmod(0o644)
    with pytest.raises(ClassFileError, match="chmod 600"):
        read_class(path)
    with pytest.raises(ClassFileError, match="cannot be read"):
        read_class(path.with_name("none.csv"))
    path.chmod(0o644)
    path.write_text("Ada\n")
    assert read_class(path)[0].name == "Ada"


def test_links_in_unusable_folder_are_an_error(path: Path) -> None:
    # Something else stands there: no secret is left in another file.
    links_path(path).mkdir()
    # The temporary file with the tokens must be removed too.
    with pytest.raises(ClassFileError, match="folder"):
        write_links(path, STUDENTS, "http://lab", "nserver://lab")
    assert [file.name for file in path.parent.iterdir()] == ["students.links.csv"]
    with pytest.raises(ClassFileError, match="folder"):
        write_links(path.parent / "missing" / "students.csv", STUDENTS, "http://lab", "nserver://lab")


@pytest.mark.parametrize(("words", "world"), [([], "arena"), (["thesis_room"], "thesis_room")])
def test_class_implies_page_and_arena(words: list[str], world: str) -> None:
    options = read_options(nserver_parser(), [*words, "--class", "students.csv"])
    assert options.world == world
    assert options.viewer is not None


@pytest.mark.long
def test_thirty_starts_of_the_arena_have_room_ahead() -> None:
    arena = SimulationConfig("arena", others=tuple(robot_placements(["n150"], (), 30)[1:])).simulation()
    assert len(arena.robots) == 30
    starts = {number: robot.actual for number, robot in arena.robots.items()}
    for number, robot in arena.robots.items():
        pose = StartPose(*robot.actual)
        assert has_room_ahead(arena, pose, robot.model.body.radius_in, number), number
        # An oracle of its own: it drives there.
        robot.move_relative(ROOM_AHEAD_IN, 0.0, 0.0)
    arena.step(10.0)
    for number, robot in arena.robots.items():
        # All of ROOM_AHEAD_IN, 24 in, but for rounding.
        assert math.hypot(robot.actual.x_in - starts[number].x_in, robot.actual.y_in - starts[number].y_in) > 23.9


def test_missing_robot_and_cramped_start_are_reported(caplog: pytest.LogCaptureFixture) -> None:
    daemon = Daemon(two_robots())
    options = argparse.Namespace(students=[Student("Eve", ADA, 3)], class_file=Path("students.csv"))
    with pytest.raises(ClassFileError, match="Eve"):
        require_robots(options, daemon)
    options.students = STUDENTS
    assert require_robots(options, daemon) == STUDENTS
    assert "robots 1, 2 have less than 24 in" in caplog.text


def two_robots() -> Emulator:
    """Return an emulator of two robots; the first one cannot drive far."""
    emulator = Emulator(simulation())
    emulator.simulation.add_robot(2, StartPose(30.0, 0.0), N150, IDEAL)
    return emulator


@pytest.fixture
async def classroom(monkeypatch: pytest.MonkeyPatch) -> Any:
    made = ViewerServer.__init__

    def with_students(self: ViewerServer, daemon: Daemon) -> None:
        made(self, daemon, None, STUDENTS)

    monkeypatch.setattr(ViewerServer, "__init__", with_students)
    async with AsyncExitStack() as stack:
        here = await stack.enter_async_context(serve_viewer(two_robots()))
        teacher, ada = [await stack.enter_async_context(here.page(token)) for token in ("", ADA)]
        yield here, teacher, ada


def ask(page: Page, numbers: Iterator[int], **message: Any) -> Any:
    """Send a message and return its answer."""

    async def exchange() -> Message:
        number = next(numbers)
        await page.send_message(id=number, **message)
        return await page.answer(number)

    return exchange()


async def test_hello_names_person_robot_and_class(classroom: Any) -> None:
    _, teacher, ada = classroom
    hellos = [await page.until(lambda message: message["type"] == "hello") for page in (teacher, ada)]
    assert [(hello["name"].partition(" (")[0], hello["robot"]) for hello in hellos] == [("teacher", None), ("Ada", 1)]
    assert hellos[1]["names"] == {"1": "Ada", "2": "Bob"}


async def test_student_acts_on_own_robot_alone(classroom: Any) -> None:
    here, _, ada = classroom
    numbers = iter(range(100))
    robots = here.daemon.emulator.simulation.robots
    # Everything a student needs with the own robot.
    for allowed in (
        {"do": "call", "robot": 1, "call": "vm", "args": [10, 0, 0]}, {"do": "drive", "robot": 1, "args": [0, 0, 0]},
        {"do": "stop", "robot": 1}, {"do": "release", "robot": 1}, {"do": "reset", "robot": 1}, {"do": "gallery"},
        {"do": "kidnap", "robot": 1, "pose": [0, 200, 0, 0]}, {"do": "unlocalize", "robot": 1},
    ):  # fmt: skip
        assert (await ask(ada, numbers, **allowed))["ok"], allowed
    before = robots[2].actual
    # The robot of another student, the clock, the world, and all robots at once.
    for refused in (
        {"do": "call", "robot": 2, "call": "vm", "args": [10, 0, 0]}, {"do": "drive", "robot": 2, "args": [9, 0, 0]},
        {"do": "stop", "robot": 2}, {"do": "stop"}, {"do": "release"}, {"do": "reset"}, {"do": "reset", "robot": 2},
        {"do": "kidnap", "robot": 2, "pose": [0, 200, 0, 0]}, {"do": "control", "command": "pause"},
        {"do": "call", "robot": 1, "call": "new_world", "args": []}, {"do": "localize", "robot": 2, "method": "ekf",
                                                                      "is_lost": False},
        {"do": "call", "robot": 1, "call": "create_robot", "args": [9, 0]},
    ):  # fmt: skip
        answer = await ask(ada, numbers, **refused)
        assert not answer["ok"], refused
        assert "teacher" in answer["error"] or "robot 1 only" in answer["error"]
    # Messages without an id get an answer without one.
    click = {"do": "click", "robot": 2, "pose": [0, 0, 0, 0]}
    for silent in (click, {"do": "waypoints", "robot": 2, "points": []}):
        await ada.send_message(**silent)
        answer = await ada.until(lambda message: message["type"] == "answer")
        assert answer["error"] == "this page drives robot 1 only"
    assert robots[2].actual == before


async def test_only_teacher_releases_what_teacher_stopped(classroom: Any) -> None:
    here, teacher, ada = classroom
    numbers = iter(range(100))
    assert list((await ask(teacher, numbers, do="stop"))["held"]) == ["1", "2"]
    refused = await ask(ada, numbers, do="release", robot=1)
    assert refused["error"] == "robot 1 is held by teacher (viewer 1), who may release it"
    assert (await ask(teacher, numbers, do="release"))["held"] == {}
    # A student who has stopped the robot before does not release it either, nor what `nserver ctl stop` has stopped.
    for by in ("teacher (viewer 1)", "nserver ctl"):
        # The robot is held by two; a student may release only what students alone have stopped.
        await ask(ada, numbers, do="stop", robot=1)
        here.daemon.hold([1], by)
        refused = await ask(ada, numbers, do="release", robot=1)
        assert refused["error"].endswith("who may release it")
        assert (await ask(teacher, numbers, do="release"))["held"] == {}
    # What a student has stopped, the same student releases, on another page too.
    await ask(ada, numbers, do="stop", robot=1)
    async with here.page(ADA) as other:
        assert (await ask(other, numbers, do="release", robot=1))["held"] == {}


async def test_reset_returns_robots_as_starts_become_free(classroom: Any) -> None:
    here, teacher, _ = classroom
    numbers = iter(range(100))
    world = here.daemon.emulator.simulation
    starts = {number: robot.actual for number, robot in world.robots.items()}
    # Robot 1 stands on the start of robot 2, which is elsewhere.
    world.place(2, 0.0, 50.0, 0.0, 0.0)
    world.place(1, 30.0, 0.0, 1.0, 1.0)
    assert (await ask(teacher, numbers, do="reset", robot=2))["error"].startswith("reset: no room")
    # All robots are returned together: a start that another one occupies becomes free.
    assert (await ask(teacher, numbers, do="reset"))["ok"]
    assert {number: robot.actual for number, robot in world.robots.items()} == starts
    assert world.robots[1].encoder == starts[1]


@pytest.mark.long
async def test_programs_of_each_robot_are_shown(classroom: Any) -> None:
    here, teacher, _ = classroom
    _, writer = await asyncio.open_connection(HOST, here.daemon.emulator.port)
    writer.write(codec.encode_tcp_request(Call("connect_robot", (2, 1))))
    # The client's own address is how the server names it.
    name = "{}:{}".format(*writer.get_extra_info("sockname"))
    await teacher.until(lambda message: message["type"] == "programs" and message["robots"] == {"2": [name]})
    writer.close()
    await teacher.until(lambda message: message["type"] == "programs" and message["robots"] == {})


@pytest.mark.long
async def test_pages_of_students_do_not_keep_the_teacher_out(classroom: Any) -> None:
    here, *_ = classroom
    # Two viewers are allowed and present; the limit does not apply to the teacher.
    here.daemon.admission.limits = Limits(viewers=2)
    with pytest.raises(WSServerHandshakeError, match="503"):
        async with here.page(BOB):
            pass
    async with here.page() as page:
        await page.until(lambda message: message["type"] == "hello")


async def test_publishing_with_a_students_token(classroom: Any) -> None:
    here, *_ = classroom
    estimate = json.dumps(GOOD)
    # Own robot, another's robot, an unknown token, a token for watching only.
    for token, status in ((ADA, 200), (BOB, 400), ("c" * 20, 403), (here.viewer_server.watch_token, 403)):
        async with here.web.post(f"{here.origin}/publish", params={"token": token}, data=estimate) as reply:
            assert reply.status == status
            assert status != 400 or "robot 2 only" in await reply.text()


def test_access_of_tokens() -> None:
    server = ViewerServer(Daemon(two_robots()), None, STUDENTS)
    assert server._access_of(BOB) == Access(may_act=True, robot=2, name="Bob")
    assert server._access_of(server.watch_token) == Access(may_act=False)
    assert server._access_of(server.token) == Access(may_act=True, name="teacher")
    # A character outside ASCII must not raise an error in the comparison of tokens.
    assert server._access_of("ä") is None
