"""Deferred replies: they need simulated time (ws, zr, arm_ws), or a click in the viewer (get_robot_conf)."""

from collections.abc import Callable
from dataclasses import dataclass

from nclient.protocol.replies import Reply
from nserver_emu.server.session import ConnectionContext, DeferredReply

# Replies that need simulated time.


class PolledReply:
    """A deferred reply that is built at the moment it is due, however late its session fetches it."""

    def __init__(self, context: ConnectionContext, poll: DeferredReply) -> None:
        self.context = context
        self.reply: Reply | None = None
        self._poll = poll

    def __call__(self) -> Reply | None:
        """Return the reply if it exists now."""
        if self.reply is None:
            self.reply = self._poll()
        return self.reply


class DeferredReplies:
    """All deferred replies, polled each time simulated time has passed."""

    def __init__(self) -> None:
        self._pending: list[PolledReply] = []

    def __len__(self) -> int:
        return len(self._pending)

    def add(self, context: ConnectionContext, poll: DeferredReply) -> PolledReply:
        """Add the deferred reply of a connection."""
        reply = PolledReply(context, poll)
        self._pending.append(reply)
        return reply

    def poll(self) -> None:
        """Build the replies that are due."""
        self._pending = [reply for reply in self._pending if reply() is None]

    def cancel(self, context: ConnectionContext) -> None:
        """Drop the deferred replies of a connection."""
        self._pending = [reply for reply in self._pending if reply.context is not context]


# get_robot_conf: a pose clicked in the viewer.

# x, y, steering and turret in tenths.
ClickedPose = tuple[int, int, int, int]


@dataclass(eq=False, slots=True)
class PoseRequest:
    """A connection that waits for a pose."""

    robot_id: int
    context: ConnectionContext
    pose: ClickedPose | None = None


class PoseRequests:
    """Pending requests for a clicked pose. One click answers all requests for that robot."""

    def __init__(self) -> None:
        # True while a viewer with permission to click is open; without one, requests are answered at once.
        self.open = False
        self._requests: list[PoseRequest] = []

    def add(
        self, robot_id: int, context: ConnectionContext, default: Callable[[], ClickedPose]
    ) -> Callable[[], ClickedPose | None]:
        """Request a pose of a robot.

        Returns
        -------
        Callable
            Poll it until it returns a pose. It returns `default()` as soon as no viewer is open.
        """
        request = PoseRequest(robot_id, context)
        self._requests.append(request)

        def poll() -> ClickedPose | None:
            if request.pose is None and not self.open:
                self._requests = [other for other in self._requests if other is not request]
                request.pose = default()
            return request.pose

        return poll

    def counts(self) -> dict[int, int]:
        """Return the number of pending requests by robot."""
        counts: dict[int, int] = {}
        for request in self._requests:
            counts[request.robot_id] = counts.get(request.robot_id, 0) + 1
        return counts

    def answer(self, robot_id: int, pose: ClickedPose) -> bool:
        """Answer the requests for a robot with a clicked pose; return True if there were any."""
        pending = [request for request in self._requests if request.robot_id == robot_id]
        for request in pending:
            request.pose = pose
        self._requests = [request for request in self._requests if request.pose is None]
        return bool(pending)

    def cancel(self, context: ConnectionContext) -> None:
        """Drop the requests of a closed connection."""
        self._requests = [request for request in self._requests if request.context is not context]
