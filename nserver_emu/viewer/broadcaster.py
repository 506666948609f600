"""Broadcasting to the open pages: which messages each viewer gets next. No sockets, no clock.

    history.take() ──> next_for(viewer)   the newest picture, as the difference to the one that this viewer has
    notify(text)   ──> next_for(viewer)   other messages, in order

A slow viewer gets the newest picture and never a backlog: at most MAX_UNDRAWN pictures are sent that it has not drawn.
Of other messages MAX_MESSAGES wait; then the oldest are dropped, and the viewer is informed how many. Viewers that have
the same picture share the encoded difference. A new viewer starts with the next picture, since the newest may be old:
pictures are taken only while a page is open.
"""

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from typing import Final

from nserver_emu.viewer.messages import encode_message
from nserver_emu.viewer.scene import Modes, SceneHistory

MAX_UNDRAWN: Final = 10
"""Pictures in flight to a viewer: half a second of them."""
# Bound of the memory for a page that receives nothing until it is disconnected.
MAX_MESSAGES: Final = 1000


class Viewer:
    """One open page.

    Attributes
    ----------
    may_act : True if it may do more than watch.
    robot, person : the only robot on which a student may act, None for all, and the name of the person, if known.
    name : name in logs and for other viewers.
    joined_at : number of the newest picture when the page was opened.
    on_message : called when a message is waiting.
    latest : number of the latest picture sent; `drawn`: of the latest one drawn; `sent`: how many were sent.
    traffic, laser : True if it wants traffic rows, laser points; `laser_robot`: of this robot, None for all.
    dropped : number of messages dropped since the last message about it.
    """

    def __init__(self, *, may_act: bool, name: str = "viewer", joined_at: int = 0) -> None:
        self.may_act = may_act
        self.robot: int | None = None
        self.person = ""
        self.name = name
        self.joined_at = joined_at
        self.on_message: Callable[[], object] = lambda: None
        self.latest = 0
        self.drawn = 0
        self.sent = 0
        self.traffic = False
        self.laser = False
        self.laser_robot: int | None = None
        self.dropped = 0
        self._undrawn: deque[int] = deque()
        self._messages: deque[str] = deque()

    def notify(self, text: str) -> None:
        """Queue a message."""
        if len(self._messages) >= MAX_MESSAGES:
            self._messages.popleft()
            self.dropped += 1
        self._messages.append(text)
        self.on_message()

    def take_messages(self) -> Sequence[str]:
        """Return the queued messages, and remove them from the queue."""
        if not self._messages:
            return ()
        messages = list(self._messages)
        self._messages.clear()
        # The page learns that its list of messages has a gap.
        if self.dropped:
            messages.append(encode_message("missed", count=self.dropped))
            self.dropped = 0
        return messages

    @property
    def is_behind(self) -> bool:
        """True if so many pictures are in flight that the next has to wait."""
        return len(self._undrawn) >= MAX_UNDRAWN

    def mark_sent(self, frame: int) -> None:
        """Record that this picture was sent."""
        self.latest = frame
        self.sent += 1
        self._undrawn.append(frame)

    def mark_drawn(self, frame: int) -> None:
        """Record that the page has drawn or skipped this picture, and so all before it."""
        self.drawn = max(self.drawn, frame)
        while self._undrawn and self._undrawn[0] <= frame:
            self._undrawn.popleft()


class Broadcaster:
    """The open pages, and the messages for each of them."""

    def __init__(self, history: SceneHistory) -> None:
        self.viewers: set[Viewer] = set()
        self._history = history
        self._differences: dict[int, str] = {}
        """Encoded differences to the newest picture, by the number of the older one."""
        self._viewer_count = 0

    def join(self, *, may_act: bool, person: str = "") -> Viewer:
        """Add a viewer; its name contains that of the person, if it is known, and is unique."""
        self._viewer_count += 1
        name = f"viewer {self._viewer_count}"
        viewer = Viewer(may_act=may_act, name=f"{person} ({name})" if person else name, joined_at=self._history.number)
        viewer.person = person
        self.viewers.add(viewer)
        return viewer

    def leave(self, viewer: Viewer) -> None:
        """Remove a viewer. May be called twice."""
        self.viewers.discard(viewer)

    def notify(self, text: str, *, traffic: bool = False) -> None:
        """Queue a message for all viewers, or for those that watch the traffic."""
        for viewer in self.viewers:
            if viewer.traffic or not traffic:
                viewer.notify(text)

    @property
    def watch_traffic(self) -> bool:
        """True if any viewer watches the traffic."""
        return any(viewer.traffic for viewer in self.viewers)

    def take(self, modes: Modes | None = None) -> None:
        """Take a new picture; `modes` are the laser modes of the robots' clients."""
        # Differences are to the newest picture, so all are outdated now.
        self._differences.clear()
        # None stands for all robots.
        watched = {viewer.laser_robot for viewer in self.viewers if viewer.laser}
        self._history.take(lasers=None if None in watched else watched, modes=modes)

    def next_for(self, viewer: Viewer) -> Iterator[str]:
        """Yield the next messages for a viewer, the picture last, so that a failing picture holds back no message."""
        yield from viewer.take_messages()
        if self._history.number > max(viewer.latest, viewer.joined_at) and not viewer.is_behind:
            text = self._difference_since(viewer.latest)
            viewer.mark_sent(self._history.number)
            yield text

    def _difference_since(self, number: int) -> str:
        if number not in self._differences:
            self._differences[number] = encode_message("picture", **self._history.since(number))
        return self._differences[number]
