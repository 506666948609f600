"""The table of readers: every place where bytes or text from outside become values."""

from __future__ import annotations

from fuzz import command_text, messages, saved_files, text_files, wire
from fuzz.reader import Reader

_MODULES = (wire, text_files, saved_files, messages, command_text)
READERS: dict[str, Reader] = {reader.name: reader for module in _MODULES for reader in module.READERS}
