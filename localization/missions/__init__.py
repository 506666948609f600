"""Missions: robot tasks as Python programs or lists of steps in TOML, and the report of a run."""

from localization.missions.mission import Mission, Seen
from localization.missions.report import MissionOver, StepFailed
from localization.missions.settings import OnLost, Settings

__all__ = ["Mission", "MissionOver", "OnLost", "Seen", "Settings", "StepFailed"]
