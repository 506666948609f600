"""A mission that was read, of whatever kind its file is: values, and the question whether its map is there."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from localization.missions.mission import Mission
from localization.missions.settings import Settings
from nclient.errors import MissionFileError, WorldFileError
from worlds.files import load_world


@dataclass(frozen=True, slots=True)
class Orders:
    """What a mission is bound to, what it does, and where its map is told: file, line or key."""

    settings: Settings
    run: Callable[[Mission], object]
    map_told: str

    def check_map(self) -> None:
        """Read the walls that it names, if any. Raises MissionFileError."""
        try:
            if self.settings.map:
                load_world(self.settings.map)
        except WorldFileError as error:
            raise MissionFileError(f"{self.map_told}: {error}") from error
