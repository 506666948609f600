"""THE table of readers: every place where bytes or text from outside become values."""

from __future__ import annotations

from fuzz import files, kept, page, wire, words
from fuzz.reader import Reader

READERS: dict[str, Reader] = {
    reader.name: reader for room in (wire, files, kept, page, words) for reader in room.READERS
}
