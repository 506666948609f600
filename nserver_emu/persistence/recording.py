"""The header of a server's recording: everything that is needed to start the same simulation again.

    header   world, robot, start, others, noise, setup, seed | pace | permissions | snapshot | port

Whatever changes a reply must be in the header or in an entry. Files of world, models and setup are stored by name, with
a digest that shows whether they have changed since; a snapshot is stored as a whole, because a server that was restored
from it may overwrite it. No clock, no socket.
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
from nserver_emu.server.handlers.table import Emulator
from nserver_emu.server.server_state import Allowed, SimulationClock
from nserver_emu.simulation.noise import SUFFIX
from worlds.io import world_names
from worlds.world import StartPose

SERVER: Final = "nserver"
"""Value of "by" in the header of a server's recording."""


@dataclass(frozen=True, slots=True)
class RunHeader:
    """The initial conditions of a server's simulation.

    Attributes
    ----------
    config
        World, robots, seed and setup.
    clock
        Relation of simulated to real time.
    allowed
        Permissions and limits of clients.
    restored
        File of the snapshot that the run continues; None: none.
    keeps_pace
        True: with the clock of the snapshot, not with `clock`.
    snapshot_text
        Contents of that file at the time; None: read it.
    """

    config: SimulationConfig
    clock: SimulationClock
    allowed: Allowed
    restored: Path | None = None
    keeps_pace: bool = False
    snapshot_text: str | None = None

    def create_emulator(self) -> Emulator:
        """Return the simulation in its initial state. Raises the errors of a server's start."""
        # The configuration decides the kind of the emulator; a snapshot then replaces its state.
        emulator = Emulator(self.config.simulation(), clock=replace(self.clock), allowed=self.allowed)
        if self.restored:
            if self.snapshot_text:
                snapshot.loads(emulator, self.snapshot_text, str(self.restored))
            else:
                snapshot.restore(emulator, self.restored)
            emulator.clock = emulator.clock if self.keeps_pace else replace(self.clock)
        return emulator

    def to_json(self, started: str, **server: int) -> dict[str, Any]:
        """Return the header of a recording. Raises SnapshotError if the snapshot can no longer be read.

        Parameters
        ----------
        started
            Start of the run, ISO 8601.
        server
            `port`, the reply to a connection; `requests_a_turn`, processed before it is another client's turn;
            `real_robots`, the number of robots that reply in place of the simulation.
        """
        # Absolute paths: a replay may run in another folder.
        files = {name: str(path.absolute()) for name, path in _files(self.config).items()}
        restored = self.restored
        return {
            "package": version(), "started": started, "by": SERVER, "time": "simulated",
            "setting": asdict(self.config) | {"model_file": None} | files,
            "digests": {path: _digest(Path(path)) for path in files.values()},
            "pace": asdict(self.clock), "allowed": asdict(self.allowed), "keeps_pace": self.keeps_pace,
            "restored": restored and str(restored.absolute()), "snapshot": restored and snapshot.text_of(restored),
        } | server  # fmt: skip

    @classmethod
    def from_json(cls, header: Mapping[str, Any], name: str) -> RunHeader:
        """Return the initial conditions of a recording; `name` is its file in errors.

        Raises
        ------
        RecordingError
            If the header lacks something, or if a file that it names has changed.
        """
        # 1. Values.
        try:
            values = dict(header["setting"])
            others = tuple((model, _start(start)) for model, start in values["others"])
            changes = {"start": _start(values["start"]), "others": others, "model_file": _path(values["model_file"])}
            config = SimulationConfig(**values | changes)
            clock, allowed = SimulationClock(**header["pace"]), Allowed(**header["allowed"])
            clock.check()
            _ = header["port"], header["requests_a_turn"]
            digests = dict(header.get("digests", {}))
        except (KeyError, TypeError, ValueError) as error:
            raise RecordingError(f"{name}, line 1: no valid description of the simulation ({error!r})") from None
        # 2. Files that are stored by name.
        for path in map(str, _files(config).values()):
            if path in digests and _digest(Path(path)) not in ("", digests[path]):
                raise RecordingError(f"{name}: {path} has changed since the recording; restore its previous contents")
        restored, text = _path(header.get("restored")), header.get("snapshot")
        return cls(config, clock, allowed, restored, bool(header.get("keeps_pace")), text and str(text))


def _files(config: SimulationConfig) -> dict[str, Path]:
    """Return the files that a configuration names, by its fields."""
    named: dict[str, Path] = {}
    if config.world not in world_names():
        named["world"] = Path(config.world)
    if config.setup.endswith(SUFFIX):
        named["setup"] = Path(config.setup)
    if config.model_file is not None:
        named["model_file"] = config.model_file
    return named


def _digest(path: Path) -> str:
    """Return the digest of a file; "" if it cannot be read, which its reader reports."""
    try:
        if not path.is_file():
            return ""
        with path.open("rb") as file:
            return file_digest(file, "sha256").hexdigest()
    except (OSError, ValueError):
        return ""


def _start(values: Mapping[str, float] | None) -> StartPose | None:
    return None if values is None else StartPose(**values)


def _path(text: str | None) -> Path | None:
    return Path(text) if text else None
