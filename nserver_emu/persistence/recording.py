"""What a recording of a daemon says of the simulation behind it, and the same simulation again from that.

    header   world, robot, start, others, noise, setup, seed | pace | permissions | snapshot | port

Rules: the header alone makes an emulator that goes the recorded way: whatever changes an answer must stand there or in
an entry. Files of world, models and setup are named, not copied, with a digest that tells when they have changed since;
a snapshot stands there whole, for the daemon that was restored from it may save over it. No clock, no socket.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from hashlib import file_digest
from pathlib import Path
from typing import Any, Final

from nclient.common.hints import version
from nclient.errors import RecordingError
from nserver_emu.persistence import snapshot
from nserver_emu.server.config import SimulationConfig
from nserver_emu.server.context import Allowed, SimulationClock
from nserver_emu.server.handlers.table import Emulator
from nserver_emu.simulation.noise import SUFFIX
from worlds.io import world_names
from worlds.world import StartPose

DAEMON: Final = "nserver"


@dataclass(frozen=True, slots=True)
class Beginning:
    """How a daemon's simulation begins. `restored`: the file of the snapshot that it goes on from, at its pace or at
    this one; `snapshot_text`: what stood in it, where that is known."""

    setting: SimulationConfig
    pace: SimulationClock
    allowed: Allowed
    restored: Path | None = None
    keeps_pace: bool = False
    snapshot_text: str | None = None

    def emulator(self) -> Emulator:
        """That simulation, at its beginning. Raises what a daemon's start may raise."""
        emulator = Emulator(self.setting.simulation(), clock=replace(self.pace), allowed=self.allowed)
        if self.restored:
            if self.snapshot_text:
                snapshot.loads(emulator, self.snapshot_text, str(self.restored))
            else:
                snapshot.restore(emulator, self.restored)
            emulator.clock = emulator.clock if self.keeps_pace else replace(self.pace)
        return emulator


def header(beginning: Beginning, started: str, **of_daemon: int) -> dict[str, Any]:
    """What the recording of a daemon begins with. Raises SnapshotError where its snapshot cannot be read any more.

    started      when, as ISO 8601
    of_daemon    `port`, which connecting is answered; `requests_a_turn`, answered before it is another client's turn;
                 `real_robots`, how many answer in place of the simulation
    """
    setting = beginning.setting
    files = {name: str(path.absolute()) for name, path in _files(setting).items()}
    restored = beginning.restored
    return {
        "package": version(), "started": started, "by": DAEMON, "time": "simulated",
        "setting": asdict(setting) | {"model_file": None} | files,
        "digests": {path: _digest(Path(path)) for path in files.values()},
        "pace": asdict(beginning.pace), "allowed": asdict(beginning.allowed), "keeps_pace": beginning.keeps_pace,
        "restored": restored and str(restored.absolute()), "snapshot": restored and snapshot.text_of(restored),
    } | of_daemon  # fmt: skip


def beginning_of(found: Mapping[str, Any], name: str) -> Beginning:
    """How the daemon of a recording began. Raises RecordingError where the header does not tell; `name`: the file."""
    try:
        told = dict(found["setting"])
        others = tuple((model, _start(start)) for model, start in told["others"])
        changes = {"start": _start(told["start"]), "others": others, "model_file": _path(told["model_file"])}
        setting = SimulationConfig(**told | changes)
        pace, allowed = SimulationClock(**found["pace"]), Allowed(**found["allowed"])
        pace.check()
        _ = found["port"], found["requests_a_turn"]
        digests = dict(found.get("digests", {}))
    except (KeyError, TypeError, ValueError) as error:
        raise RecordingError(f"{name}, line 1: does not tell how the simulation began ({error!r})") from None
    for path in map(str, _files(setting).values()):
        if path in digests and _digest(Path(path)) not in ("", digests[path]):
            raise RecordingError(f"{name}: began with {path}, which has changed since; bring it back as it was")
    restored, text = _path(found.get("restored")), found.get("snapshot")
    return Beginning(setting, pace, allowed, restored, bool(found.get("keeps_pace")), text and str(text))


def _files(setting: SimulationConfig) -> dict[str, Path]:
    """The files that a setting names, by its fields."""
    named: dict[str, Path] = {}
    if setting.world not in world_names():
        named["world"] = Path(setting.world)
    if setting.setup.endswith(SUFFIX):
        named["setup"] = Path(setting.setup)
    if setting.model_file is not None:
        named["model_file"] = setting.model_file
    return named


def _digest(path: Path) -> str:
    """Of what stands in a file; "" where it is none or cannot be read, which whoever reads it for good says."""
    try:
        if not path.is_file():
            return ""
        with path.open("rb") as file:
            return file_digest(file, "sha256").hexdigest()
    except (OSError, ValueError):
        return ""


def _start(told: Mapping[str, float] | None) -> StartPose | None:
    return None if told is None else StartPose(**told)


def _path(told: str | None) -> Path | None:
    return Path(told) if told else None
