"""Localizers that the page starts: the command, the states shown, and the end of the process in every case."""

from __future__ import annotations

import asyncio
import json
import os
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, get_args

import pytest

from localization.filters.registry import METHODS
from nserver_emu.gateway.gateway import Gateway
from nserver_emu.server.daemon import Daemon
from nserver_emu.server.handlers.table import Emulator
from nserver_emu.simulation.noise import SETUPS
from nserver_emu.viewer import localizers
from nserver_emu.viewer.localizers import Localizers
from nserver_emu.viewer.messages import InvalidMessage, LocalizationMethod
from tests.nserver_emu.server.wire_client import simulation
from tests.nserver_emu.viewer.page_client import serve_viewer
from worlds.io import load_world
from worlds.world import Walker

WAITS = "exec sleep 60"


class Running:
    """Localizers whose program is a shell script, and the states that they have reported."""

    def __init__(self, script: str) -> None:
        self.daemon = Daemon(Emulator(simulation()))
        self.daemon.places["nserver"] = "0.0.0.0:7019"
        self.reported: list[dict[str, Any]] = []
        self.changed = asyncio.Event()
        self.localizers = Localizers(self.daemon, self.report, ("sh", "-c", script, "nomad"))
        self.localizers.page_url = "http://127.0.0.1:7080/?token=secret"

    def report(self) -> None:
        self.reported.append(self.localizers.as_dict())
        self.changed.set()

    async def until(self, state: str) -> dict[str, str]:
        """Wait for a state of robot 1 and return it."""
        async with asyncio.timeout(10):
            while (shown := self.localizers.as_dict()["1"])["state"] != state:
                self.changed.clear()
                await self.changed.wait()
        return shown


@asynccontextmanager
async def running(script: str) -> AsyncIterator[Running]:
    here = Running(script)
    try:
        yield here
    finally:
        await here.localizers.close()


def test_methods_are_those_of_the_program() -> None:
    assert get_args(LocalizationMethod) == tuple(METHODS)


async def command_of(tmp_path: Path, robot_setup: str, **options: Any) -> tuple[Sequence[str], str]:
    """Return the arguments and the published address that a localizer gets."""
    # The localizer is a shell script that writes its arguments to a file and ends, which counts as failed.
    file = tmp_path / "arguments"
    async with running(f'printf "%s\\n" "$@" $NOMAD_PUBLISH >{file}') as here:
        robot = here.daemon.emulator.simulation.robots[1]
        robot.set_noise_model(SETUPS[robot_setup])
        here.localizers.start(1, "ekf", **({"is_lost": False} | options))
        await here.until("failed")
    *arguments, url = file.read_text().splitlines()
    return arguments, url


async def test_command_has_robot_map_and_models(tmp_path: Path) -> None:
    arguments, url = await command_of(tmp_path, "ideal")
    assert arguments[:2] == ["localize", "nserver://127.0.0.1:7019/1"]
    assert " --stay --json --time-limit 1e+09 --method ekf --sonars rays --save" in " ".join(arguments)
    # The address with the token is in the environment: arguments are visible to all users (ps).
    assert url == "http://127.0.0.1:7080/?token=secret"
    assert "secret" not in " ".join(arguments)


async def test_only_own_filters_of_the_start_are_run(tmp_path: Path) -> None:
    file = tmp_path / "arguments"
    async with running(f'echo "$@" >{file}') as here:
        here.localizers.own_methods = ("/home/me/filters.py:Mine",)
        for wrong in ("/home/me/filters.py:Other", "/home/me/other.py:Mine", "ekff"):
            with pytest.raises(InvalidMessage, match=r"filters\.py:Mine"):
                here.localizers.start(1, wrong, is_lost=False)
        assert not here.localizers.states
        here.localizers.start(1, "/home/me/filters.py:Mine", is_lost=False)
        await here.until("failed")
    assert " --method /home/me/filters.py:Mine " in file.read_text()


async def test_command_fits_the_noise(tmp_path: Path) -> None:
    arguments, _ = await command_of(tmp_path, "measured", is_lost=True, resumes=True)
    # Cones for measured sonars; for worn wheels, the std of the scales.
    assert " --start unknown --sonars cones --save" in " ".join(arguments)
    arguments, _ = await command_of(tmp_path, "worn")
    assert " --sonars rays --scale-std 0.05,0.05,0.003 --save" in " ".join(arguments)


async def test_all_robots_get_a_localizer_up_to_the_limit(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    async with running(WAITS) as here:
        here.localizers.start_all()
        assert [each["method"] for each in here.localizers.as_dict().values()] == ["ekf"]
        assert not caplog.messages
    async with running(WAITS) as here:
        monkeypatch.setattr(localizers, "MAX_LOCALIZERS", 0)
        here.localizers.start_all()
        assert not here.localizers.states
        assert "first 0 of 1" in caplog.text


async def test_stopped_process_ends_and_is_reported() -> None:
    async with running(f"echo $$; {WAITS}") as here:
        here.localizers.start(1, "finder", is_lost=True)
        here.localizers.mark_published(1)
        # "running" begins with the first published estimate.
        shown = await here.until("running")
        # A robot without localizer: no effect.
        here.localizers.mark_published(2)
        here.localizers.stop(1)
        ended = {"method": "finder", "state": "ended", "words": "stopped", "has_old_map": False}
        assert await here.until("ended") == ended
        assert shown["words"] == ""
        # Stopping twice is no error.
        here.localizers.stop(1)


async def test_new_localizer_replaces_the_one_before(tmp_path: Path) -> None:
    pids = tmp_path / "pids"
    async with running(f"echo $$ $* >>{pids}; {WAITS}") as here:
        here.localizers.start(1, "ekf", is_lost=False)
        async with asyncio.timeout(10):
            while not pids.exists():
                await asyncio.sleep(0.01)
            folder = next(Path(word).parent for word in pids.read_text().split() if word.endswith(".toml"))
            # The first localizer has saved an estimate...
            (folder / "robot_1_estimate.json").write_text("{}")
            here.localizers.start(1, "mcl", is_lost=False, resumes=True)
            while len(pids.read_text().splitlines()) < 2:
                await asyncio.sleep(0.01)
    first, second = pids.read_text().splitlines()
    assert "--resume" not in first
    # ... with which the second one begins.
    assert f"--resume {folder}/robot_1_estimate.before" in second
    for line in (first, second):
        # Signal 0 tests if a process exists.
        with pytest.raises(ProcessLookupError):
            os.kill(int(line.split()[0]), 0)
    assert not folder.exists()


async def test_process_that_ignores_signals_is_killed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(localizers, "END_S", 0.1)
    # SIGTERM is ignored, so SIGKILL must follow after END_S.
    async with running('trap "" TERM; echo ready; while :; do sleep 0.2; done') as here:
        here.localizers.start(1, "ekf", is_lost=False)
        async with asyncio.timeout(10):
            while here.localizers.states[1].words != "ready":
                await asyncio.sleep(0.01)
        here.localizers.stop(1)
        await here.until("ended")


def is_alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


async def pid_of(here: Running) -> int:
    """Return the number of the process, its first line."""
    await here.until("starting")
    async with asyncio.timeout(10):
        while not here.localizers.states[1].words:
            await asyncio.sleep(0.01)
    return int(here.localizers.states[1].words)


async def test_process_ends_however_often_it_is_stopped(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(localizers, "END_S", 0.3)
    async with running('trap "" TERM; echo $$; while :; do sleep 0.1; done') as here:
        here.localizers.start(1, "ekf", is_lost=False)
        pid = await pid_of(here)
        for _ in range(3):
            here.localizers.stop(1)
            await asyncio.sleep(0.01)
        here.localizers.start(1, "ekf", is_lost=False)
        await here.localizers.close()
        # Stopped three times and then replaced: the first process must not be left.
        assert not is_alive(pid)


async def test_start_and_stop_at_once_end_the_one_before() -> None:
    async with running(f"echo $$; {WAITS}") as here:
        here.localizers.start(1, "ekf", is_lost=False)
        pid = await pid_of(here)
        # The second is stopped before the first has ended: neither may be left.
        here.localizers.start(1, "mcl", is_lost=False)
        here.localizers.stop(1)
        await here.until("ended")
        await here.localizers.close()
        assert not is_alive(pid)


async def test_localizer_that_cannot_be_started_replaces_none(monkeypatch: pytest.MonkeyPatch) -> None:
    async with running(f"echo $$; {WAITS}") as here:
        here.localizers.start(1, "ekf", is_lost=False)
        pid = await pid_of(here)

        def fail(_robot: int) -> Path:
            raise OSError(28, "No space left on device")

        # The map of the new one cannot be written: the old one must continue.
        monkeypatch.setattr(here.localizers, "_write_map", fail)
        with pytest.raises(InvalidMessage, match="TMPDIR"):
            here.localizers.start(1, "mcl", is_lost=False)
        assert is_alive(pid)
        assert here.localizers.states[1].method == "ekf"
        monkeypatch.undo()
        monkeypatch.setattr(localizers, "MAX_LOCALIZERS", 1)
        with pytest.raises(InvalidMessage, match="already"):
            here.localizers.start(2, "ekf", is_lost=False)
        await here.localizers.close()
        assert not is_alive(pid)
        with pytest.raises(InvalidMessage, match="ends"):
            here.localizers.start(1, "ekf", is_lost=False)


async def test_changed_world_makes_the_map_old() -> None:
    async with running(f"echo $$; {WAITS}") as here:
        here.localizers.start(1, "ekf", is_lost=False)
        await pid_of(here)
        simulated = here.daemon.emulator.simulation
        world = simulated.world
        changed = world.with_inner_wall(0, (20.0, 20.0, 30.0, 20.0))
        # People who walk are in no map.
        walked = replace(world, walkers=(Walker(((30.0, 30.0), (30.0, 40.0))),))
        # Each change is compared with the world at the start; walkers are not part of a map.
        for now, is_old in ((world, False), (changed, True), (world, False), (changed, True), (walked, False)):
            simulated.change_world(now)
            here.localizers.check_maps()
            assert here.localizers.as_dict()["1"]["has_old_map"] is is_old
            assert here.reported[-1]["1"]["has_old_map"] is is_old


async def test_words_do_not_have_the_token() -> None:
    async with running("echo nomad: cannot reach $NOMAD_PUBLISH; exit 1") as here:
        here.localizers.start(1, "ekf", is_lost=False)
        assert (await here.until("failed"))["words"] == "cannot reach http://127.0.0.1:7080/?token=..."


@pytest.mark.parametrize(
    ("script", "words"),
    [("echo 'nomad: --publish needs x: pip install y' >&2; exit 1", "--publish needs x: pip install y"),
     ("echo Traceback >&2; exit 1", "exit code 1: Traceback"), ("exit 2", "exit code 2: without a word"),
     # Two megabytes without a newline: output is read in bounded pieces.
     ("head -c 2000000 /dev/zero", "exit code")],
)  # fmt: skip
async def test_failure_is_reported_with_its_remedy(script: str, words: str) -> None:
    async with running(script) as here:
        here.localizers.start(1, "ekf", is_lost=False)
        assert words in (await here.until("failed"))["words"]


async def test_stalled_run_has_ended_with_its_reason() -> None:
    result = json.dumps({"stopped": "no progress"})
    async with running(f"echo 'nomad: waiting'; echo '{result}'; exit 3") as here:
        here.localizers.start(1, "ekf", is_lost=False)
        assert (await here.until("ended"))["words"] == "no progress"
        assert ("starting", "waiting") in [(shown["1"]["state"], shown["1"]["words"]) for shown in here.reported]


async def test_missing_program_is_reported() -> None:
    async with running("") as here:
        here.localizers = Localizers(here.daemon, here.report, ("/nowhere/nomad",))
        here.localizers.start(1, "ekf", is_lost=False)
        assert "cannot start /nowhere/nomad" in (await here.until("failed"))["words"]


async def test_pages_start_and_stop_localizers() -> None:
    async with serve_viewer(Emulator(simulation())) as here, here.page() as page:
        started = here.viewer_server.controller.localizers
        started._program = ("sh", "-c", WAITS, "nomad")
        assert started.page_url == f"{here.origin}/?token={here.viewer_server.token}"
        await page.send_message(do="localize", id=1, robot=1, method="ekf", is_lost=False)
        shown = await page.until(lambda message: message["type"] == "localizers" and message["robots"])
        wanted = {"method": "ekf", "state": "starting", "words": "", "has_old_map": False}
        assert shown["robots"] == {"1": wanted}
        assert (await page.answer(1))["ok"]
        async with here.page() as late:
            assert (await late.until(lambda message: message["type"] == "localizers"))["robots"] == shown["robots"]
        await page.send_message(do="unlocalize", id=2, robot=1)
        await page.until(lambda message: message["type"] == "localizers" and message["robots"]["1"]["state"] == "ended")
        for wrong in ({"robot": 7, "method": "ekf"}, {"robot": 1, "method": "magic"}):
            await page.send_message(do="localize", id=3, is_lost=False, **wrong)
            assert not (await page.answer(3))["ok"]


async def test_map_has_the_poses_where_encoders_were_right(tmp_path: Path) -> None:
    file = tmp_path / "map"
    async with serve_viewer(Emulator(simulation())) as here, here.page() as page:
        here.viewer_server.controller.localizers._program = ("sh", "-c", f"cp $4 {file}", "nomad")
        await page.send_message(do="call", id=1, robot=1, call="place_robot", args=[300, 200, 900, 450])
        await page.answer(1)
        await page.send_message(do="localize", id=2, robot=1, method="ekf", is_lost=False)
        await page.until(lambda message: message["type"] == "localizers" and message["robots"]["1"]["state"] == "failed"
                         if message.get("robots") else False)
    starts = [(start.x_in, start.y_in) for start in load_world(file).starts]
    # The poses where encoders were set: at power-on, and by place_robot.
    assert starts == [(0.0, 0.0), (30.0, 20.0)]


async def test_encoders_do_not_notice_a_kidnapping() -> None:
    emulator = Emulator(simulation())
    async with serve_viewer(emulator) as here, here.page() as page:
        robot = emulator.simulation.robots[1]
        await page.send_message(do="call", id=1, robot=1, call="place_robot", args=[300, 200, 900, 450])
        await page.answer(1)
        before = robot.encoder
        # The second pose is outside the room: refused, and nothing changes.
        for number, pose, is_ok in ((2, [500, 600, 0, 0], True), (3, [-100, 0, 0, 0], False)):
            await page.send_message(do="kidnap", id=number, robot=1, pose=pose)
            assert (await page.answer(number))["ok"] == is_ok
        assert robot.actual[:2] == (50.0, 60.0)
        assert robot.encoder == pytest.approx(before)


async def test_real_robots_are_not_kidnapped() -> None:
    """Only their encoders would be set, and then to those of the simulated robot."""
    emulator = Emulator(simulation())
    async with serve_viewer(emulator) as here, here.page() as page:
        here.daemon.handler = Gateway(emulator, {})
        await page.send_message(do="kidnap", id=1, robot=1, pose=[500, 600, 0, 0])
        assert "carry it" in (await page.answer(1))["error"]
        assert emulator.simulation.robots[1].actual[:2] == (0.0, 0.0)
