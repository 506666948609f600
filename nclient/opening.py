"""How an address becomes a conversation: what a scheme and an option are, and the order in which they are put on.

    stream ─> its wrappers, in the order of the options ─> backend ─> its wrappers, in the order of the options

Rules: no scheme and no option by name: those are the rows of nclient.schemes. The same Opening opens a stream and a
conversation again when the first is lost.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from nclient.address import Address, Reader
from nclient.backends.base import Backend, LinkStatistics
from nclient.protocol.types import N150, Model
from nclient.recording.recorder import TCP
from nclient.transports.stream import ByteStream


@dataclass(frozen=True, slots=True)
class Wanted:
    """What whoever connects says besides the address: time-out (the address wins), robot by number, made if need be."""

    timeout_s: float | None = None
    robot_id: int | None = None
    create: bool = False


@dataclass(slots=True)
class Opening:
    """One address on its way to a backend; the same one each time that it is opened again.

    `values`: the options, read, with the scheme's defaults; `kept`: what a wrapper keeps from one opening of the
    stream to the next (a file that is open, a count).
    """

    address: Address
    scheme: Scheme
    wanted: Wanted
    options: tuple[Option, ...]
    values: Mapping[str, Any]
    kept: dict[str, Any] = field(default_factory=dict)

    @property
    def model(self) -> Model:
        """The robot's model, as the address says."""
        model: Model = self.values.get("model", N150)
        return model

    @property
    def timeout_s(self) -> float | None:
        """How long an answer may take, where anybody said."""
        timeout_s: float | None = self.values.get("timeout_s", self.wanted.timeout_s)
        return timeout_s

    @property
    def foreign_text(self) -> str:
        """The address without the options that every scheme has: what is left to whoever answers."""
        return self.address.without([option.name for option in self.options if option.schemes is None])

    @property
    def link(self) -> LinkStatistics:
        """The counts of this robot's link, through every opening."""
        counts: LinkStatistics = self.kept.setdefault("link", LinkStatistics())
        return counts

    def stream(self) -> ByteStream:
        """The stream with its wrappers."""
        stream = self.scheme.opens(self)
        for option, value in self._given():
            if option.stream is not None:
                stream = option.stream(stream, value, self)
        return stream

    def bare_stream(self) -> ByteStream:
        """The stream without its wrappers: for those who only want to know whether somebody is there."""
        return self.scheme.opens(self)

    def talk(self) -> Backend:
        """A conversation over a new stream, without the backend's wrappers."""
        return self.scheme.talks(self.stream(), self)

    def backend(self) -> Backend:
        """A conversation with all wrappers."""
        backend = self.talk()
        try:
            for option, value in self._given():
                if option.backend is not None:
                    backend = option.backend(backend, value, self)
        except BaseException:
            backend.close()
            raise
        return backend

    def _given(self) -> Iterator[tuple[Option, Any]]:
        return ((option, self.values[option.name]) for option in self.options if self.values.get(option.name))


@dataclass(frozen=True, slots=True)
class Option:
    """A row: a name, how its text is read (unit and range there), the wrapper it puts on, the schemes that have it."""

    name: str
    read: Reader
    stream: Callable[[ByteStream, Any, Opening], ByteStream] | None = None
    backend: Callable[[Backend, Any, Opening], Backend] | None = None
    schemes: frozenset[str] | None = None
    """None: every scheme."""

    def belongs_to(self, scheme: str) -> bool:
        """Whether an address of that scheme has this option."""
        return self.schemes is None or scheme in self.schemes


@dataclass(frozen=True, slots=True)
class Scheme:
    """A row: how such an address looks, how its stream is opened, and what is spoken over it."""

    form: str
    opens: Callable[[Opening], ByteStream]
    talks: Callable[[ByteStream, Opening], Backend]
    defaults: Mapping[str, Any] = field(default_factory=dict)
    in_process: bool = False
    """Whether what answers is in this process, its time its own."""
    reads_the_rest: bool = False
    """Whether who answers reads the options that are not ours, and has its own to say about them."""
    line: str = TCP
    """The language as recordings name it (nclient.recording.recorder.LINES)."""
