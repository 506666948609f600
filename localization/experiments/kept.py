"""Results on disk, a JSON file each: what is there already is not worked out again.

A file is named by a digest of all that decides its numbers, the code's fingerprint among it: nothing stale is ever
read, and a change leaves old files alone. Rules: files only. A file is whole: one cut short is never taken for a
result.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from hashlib import sha256
from pathlib import Path
from typing import Any

from nclient.errors import OutputFileError
from nclient.whole_file import write_whole


class Kept:
    """A folder of results that code of that fingerprint made."""

    def __init__(self, folder: Path, code: str) -> None:
        self._folder, self._code = folder, code

    def path(self, name: str, decided_by: tuple[object, ...]) -> Path:
        """Where the result of that name is kept; `decided_by`: what decides its numbers, told by its repr."""
        key = sha256(repr((self._code, *decided_by)).encode())
        return self._folder / f"{name}_{key.hexdigest()[:16]}.json"

    @staticmethod
    def get(path: Path) -> dict[str, Any] | None:
        """What is kept there, None where nothing is."""
        try:
            text = path.read_text(encoding="utf-8")
        except FileNotFoundError:
            return None
        found: dict[str, Any] = json.loads(text)
        return found

    def put(self, path: Path, result: Mapping[str, Any]) -> None:
        """Keep a result there. Raises OutputFileError where that cannot be."""
        self._folder.mkdir(parents=True, exist_ok=True)
        write_whole(path, json.dumps(result) + "\n", OutputFileError)
