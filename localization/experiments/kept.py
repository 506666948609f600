"""What is worked out once and kept on disk, a JSON file each: a long run cut short goes on where it was.

A file is named by a digest of all that decides what is in it: its key, and the code that made it (fingerprint). Nothing
stale is ever read; other code leaves old files alone. Rules: files only. A file is written under another name first, so
that one cut short is never taken for whole.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from hashlib import sha256
from pathlib import Path
from typing import Any


class Kept:
    """A folder of what code of that fingerprint made."""

    def __init__(self, folder: Path, code: str) -> None:
        self._folder, self._code = folder, code

    def path(self, name: str, *key: object) -> Path:
        """Where that is kept which a key decides; its representation must tell all of it. `name` is for people."""
        digest = sha256(repr((self._code, *key)).encode()).hexdigest()
        return self._folder / f"{name}_{digest[:16]}.json"

    def get(self, path: Path) -> dict[str, Any] | None:
        """What is kept there, None where nothing is."""
        try:
            text = path.read_text(encoding="utf-8")
        except FileNotFoundError:
            return None
        found: dict[str, Any] = json.loads(text)
        return found

    def put(self, path: Path, values: Mapping[str, Any]) -> None:
        """Keep it."""
        self._folder.mkdir(parents=True, exist_ok=True)
        unfinished = path.with_suffix(".part")
        unfinished.write_text(json.dumps(values) + "\n", encoding="utf-8")
        unfinished.replace(path)
