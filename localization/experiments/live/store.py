"""Results on disk, a JSON file a trial: what is there already is not driven again.

A file is named by a digest of all that decides its numbers: the trial (with its scenario, to the last number), the
code of this project, the version of numpy (fingerprint). Nothing stale is ever read; a change leaves old files alone.
Rules: files only. A file is written under another name first, so that one cut short is never taken for a result.
"""

from __future__ import annotations

import json
from dataclasses import asdict
from hashlib import sha256
from pathlib import Path

from localization.experiments.live.matrix import Trial
from localization.experiments.live.summary import TrialResult


class Store:
    """A folder of results of trials run by code of that fingerprint."""

    def __init__(self, folder: Path, code: str) -> None:
        self._folder, self._code = folder, code

    def path(self, trial: Trial) -> Path:
        """Where the result of a trial is kept."""
        key = sha256(repr((self._code, trial.figure, trial.seed, trial.periods, asdict(trial.scenario))).encode())
        return self._folder / f"{'_'.join(trial.cell)}_{trial.seed:04d}_{key.hexdigest()[:16]}.json"

    def get(self, trial: Trial) -> TrialResult | None:
        """The result that is kept, None where there is none."""
        try:
            text = self.path(trial).read_text(encoding="utf-8")
        except FileNotFoundError:
            return None
        return TrialResult(**json.loads(text))

    def put(self, trial: Trial, result: TrialResult) -> None:
        """Keep a result."""
        self._folder.mkdir(parents=True, exist_ok=True)
        path = self.path(trial)
        unfinished = path.with_suffix(".part")
        unfinished.write_text(json.dumps(asdict(result)) + "\n", encoding="utf-8")
        unfinished.replace(path)
