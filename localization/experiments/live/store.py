"""Results of live trials on disk, a JSON file a trial: what is there already is not driven again.

A file is named by the trial (with its scenario, to the last number) and by the code (kept, fingerprint).
Rules: names only; files are kept's.
"""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

from localization.experiments.kept import Kept
from localization.experiments.live.matrix import Trial
from localization.experiments.live.summary import TrialResult


class Store:
    """A folder of results of trials run by code of that fingerprint."""

    def __init__(self, folder: Path, code: str) -> None:
        self._kept = Kept(folder, code)

    def path(self, trial: Trial) -> Path:
        """Where the result of a trial is kept."""
        decided_by = (trial.figure, trial.seed, trial.periods, asdict(trial.scenario))
        return self._kept.path(f"{'_'.join(trial.cell)}_{trial.seed:04d}", decided_by)

    def get(self, trial: Trial) -> TrialResult | None:
        """The result that is kept, None where there is none."""
        found = self._kept.get(self.path(trial))
        return None if found is None else TrialResult(**found)

    def put(self, trial: Trial, result: TrialResult) -> None:
        """Keep a result."""
        self._kept.put(self.path(trial), asdict(result))
