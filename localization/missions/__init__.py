"""What a robot shall do, as a program of a few verbs or a list of them in a file, and the report of what it did."""

from localization.missions.mission import Mission, Seen
from localization.missions.report import MissionOver, StepFailed
from localization.missions.settings import OnLost, Settings

__all__ = ["Mission", "MissionOver", "OnLost", "Seen", "Settings", "StepFailed"]
