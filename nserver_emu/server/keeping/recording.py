"""What a recording of a daemon says of the simulation behind it, and the same simulation again from that.

    header   world, robot, start, others, noise, setup, seed | pace | permissions | snapshot | port

Rules: the header alone makes an emulator that goes the recorded way: whatever changes an answer must stand there or in
an entry. World, model and snapshot files are named, not copied. No clock, no socket.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Final

from nclient.distribution import version
from nclient.errors import RecordingError
from nserver_emu.server.handling.handlers import Emulator
from nserver_emu.server.keeping import snapshot
from nserver_emu.server.setting_up.setting import Setting
from nserver_emu.server.stage.pace import Pace
from nserver_emu.server.stage.stage import Allowed
from worlds.files import world_names
from worlds.world import StartPose

DAEMON: Final = "nserver"


@dataclass(frozen=True, slots=True)
class Beginning:
    """How a daemon's simulation begins. `restored`: the snapshot that it goes on from, at its pace or at this one."""

    setting: Setting
    pace: Pace
    allowed: Allowed
    restored: Path | None = None
    keeps_pace: bool = False

    def emulator(self) -> Emulator:
        """That simulation, at its beginning. Raises what a daemon's start may raise."""
        emulator = Emulator(self.setting.simulation(), pace=replace(self.pace), allowed=self.allowed)
        if self.restored:
            snapshot.restore(emulator, self.restored)
            emulator.pace = emulator.pace if self.keeps_pace else replace(self.pace)
        return emulator


def header(beginning: Beginning, started: str, **of_daemon: int) -> dict[str, Any]:
    """What the recording of a daemon begins with.

    started      when, as ISO 8601
    of_daemon    `port`, which connecting is answered; `requests_a_turn`, answered before it is another client's turn;
                 `real_robots`, how many answer in place of the simulation
    """
    setting = beginning.setting
    world = Path(setting.world)
    files = {
        "world": str(world.absolute()) if world.is_file() and setting.world not in world_names() else setting.world,
        "model_file": _path_text(setting.model_file),
    }
    return {
        "package": version(), "started": started, "by": DAEMON, "time": "simulated",
        "setting": asdict(setting) | files, "pace": asdict(beginning.pace), "allowed": asdict(beginning.allowed),
        "restored": _path_text(beginning.restored), "keeps_pace": beginning.keeps_pace,
    } | of_daemon  # fmt: skip


def beginning_of(found: Mapping[str, Any], name: str) -> Beginning:
    """How the daemon of a recording began. Raises RecordingError where the header does not tell; `name`: the file."""
    try:
        told = dict(found["setting"])
        others = tuple((model, _start(start)) for model, start in told["others"])
        changes = {"start": _start(told["start"]), "others": others, "model_file": _path(told["model_file"])}
        setting = Setting(**told | changes)
        pace, allowed = Pace(**found["pace"]), Allowed(**found["allowed"])
        pace.check()
        _ = found["port"], found["requests_a_turn"]
    except (KeyError, TypeError, ValueError) as error:
        raise RecordingError(f"{name}, line 1: does not tell how the simulation began ({error!r})") from None
    return Beginning(setting, pace, allowed, _path(found.get("restored")), bool(found.get("keeps_pace")))


def _start(told: Mapping[str, float] | None) -> StartPose | None:
    return None if told is None else StartPose(**told)


def _path(told: str | None) -> Path | None:
    return Path(told) if told else None


def _path_text(path: Path | None) -> str | None:
    return None if path is None else str(path.absolute())
