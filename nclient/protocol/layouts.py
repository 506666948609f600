"""A request's layout to bytes and back, as construct's `parse` and `build`, and nothing is left for Python's garbage.

Rules: construct's own make a context for each call, which holds itself: there for as long as nobody looks for garbage,
which a daemon does now and then. Here all calls share two that never change. Errors are construct's own.
"""

from __future__ import annotations

from io import BytesIO
from typing import Any, Final

from construct import Construct


class _Context:
    """What construct hands to each piece: which way it goes, and itself where a piece asks for the outermost one."""

    __slots__ = ("_building", "_parsing")
    _sizing = False

    def __init__(self, *, parsing: bool) -> None:
        self._parsing = parsing
        self._building = not parsing

    @property
    def _params(self) -> _Context:
        return self

    def get(self, name: str, default: object = None) -> object:
        """As of a dictionary that holds nothing but `_root`."""
        return self if name == "_root" else default


_PARSING: Final = _Context(parsing=True)
_BUILDING: Final = _Context(parsing=False)


def parse(layout: Construct, data: bytes) -> Any:
    """The value that these bytes are. Raises ConstructError."""
    return layout._parse(BytesIO(data), _PARSING, "(parsing)")


def build(layout: Construct, value: Any) -> bytes:
    """The bytes of a value. Raises ConstructError."""
    stream = BytesIO()
    layout._build(value, stream, _BUILDING, "(building)")
    return stream.getvalue()
