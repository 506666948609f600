"""Who looks, and what each is to be told next. Pure: no socket, no clock.

    album.take() ──> next_for(viewer)   the newest picture, from the one that this viewer has
    tell(text)   ──> next_for(viewer)   other news, in their order

Rules: a slow viewer gets the newest picture, never a backlog: no more than AHEAD pictures go out that it has not
drawn. Of other news MOST_NEWS wait; then the oldest are left out, and it is told how many. Viewers who have the same
picture share the text that takes them on. Whoever comes gets the next picture: the newest is of when somebody looked
last, which may be long ago. A viewer that is gone is forgotten.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from typing import Final

from nserver_emu.viewer.messages import to_page
from nserver_emu.viewer.scene import Album, Modes

AHEAD: Final = 10
"""Pictures on their way to a viewer: half a second of them."""
MOST_NEWS: Final = 1000


class Viewer:
    """One page that is open. `may_act`: whether it may do more than look; `ring` is called when there is news; `came`:
    the number of the picture that was the newest then."""

    def __init__(self, *, may_act: bool, name: str = "viewer", came: int = 0) -> None:
        self.may_act = may_act
        self.name = name
        self.came = came
        self.ring: Callable[[], object] = lambda: None
        self.has = 0
        self.drawn = 0
        self.sent = 0
        self.traffic = False
        self.laser = False
        self.whose_laser: int | None = None
        self.missed = 0
        self._since_drawn: deque[int] = deque()
        self._news: deque[str] = deque()

    def tell(self, text: str) -> None:
        """Something is new."""
        if len(self._news) >= MOST_NEWS:
            self._news.popleft()
            self.missed += 1
        self._news.append(text)
        self.ring()

    def news(self) -> Sequence[str]:
        """What is new and was not told yet."""
        if not self._news:
            return ()
        told = list(self._news)
        self._news.clear()
        if self.missed:
            told.append(to_page("missed", count=self.missed))
            self.missed = 0
        return told

    @property
    def behind(self) -> bool:
        """Whether so many pictures are on their way that the next has to wait."""
        return len(self._since_drawn) >= AHEAD

    def given(self, frame: int) -> None:
        """This picture goes out."""
        self.has = frame
        self.sent += 1
        self._since_drawn.append(frame)

    def saw(self, frame: int) -> None:
        """It has drawn this one, or passed over it; so are those before."""
        self.drawn = max(self.drawn, frame)
        while self._since_drawn and self._since_drawn[0] <= frame:
            self._since_drawn.popleft()


class Hub:
    """See the head of this file."""

    def __init__(self, album: Album) -> None:
        self.viewers: set[Viewer] = set()
        self._album = album
        self._texts: dict[int, str] = {}
        self._guests = 0

    def join(self, *, may_act: bool) -> Viewer:
        """Somebody opened the page."""
        self._guests += 1
        viewer = Viewer(may_act=may_act, name=f"viewer {self._guests}", came=self._album.number)
        self.viewers.add(viewer)
        return viewer

    def leave(self, viewer: Viewer) -> None:
        """The page is gone. Twice is fine."""
        self.viewers.discard(viewer)

    def tell(self, text: str, *, traffic: bool = False) -> None:
        """Something is new for all, or for those who watch the traffic."""
        for viewer in self.viewers:
            if viewer.traffic or not traffic:
                viewer.tell(text)

    @property
    def watch_traffic(self) -> bool:
        """Whether anybody looks at what clients say."""
        return any(viewer.traffic for viewer in self.viewers)

    def take(self, modes: Modes | None = None) -> None:
        """A new picture for whoever looks; `modes`: of the lasers of all robots."""
        self._texts.clear()
        looked_at = {viewer.whose_laser for viewer in self.viewers if viewer.laser}
        self._album.take(lasers=None if None in looked_at else looked_at, modes=modes)

    def next_for(self, viewer: Viewer) -> Iterator[str]:
        """What this viewer is to be told now, the picture last: what is wrong with it keeps no news back."""
        yield from viewer.news()
        if self._album.number > max(viewer.has, viewer.came) and not viewer.behind:
            text = self._text_from(viewer.has)
            viewer.given(self._album.number)
            yield text

    def _text_from(self, number: int) -> str:
        if number not in self._texts:
            self._texts[number] = to_page("picture", **self._album.since(number))
        return self._texts[number]
