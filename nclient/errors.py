"""Every error this project raises on purpose. One root, married to the standard errors people already catch.

    NomadError
    ├── AddressError (ValueError)          an address connect() cannot read, or a scheme nobody serves
    ├── ConnectionLost (ConnectionError)   the other end is gone, or was never there
    ├── ReplyTimeout (TimeoutError)        the other end is there and silent
    ├── RobotRefused                       an answer, and it is no: ERROR or NAK, with the command
    ├── BumperHit                          a bumper touched while the robot moved, and it was stopped (bumper_stop=1)
    ├── WireError (ValueError)             bytes that are no message, or values that no message can carry
    ├── WorldFileError (ValueError)        a world, model or setup file in TOML that cannot be used: file, key
    ├── StartError (ValueError)            a start pose that touches a wall or lies outside
    ├── VariableError (ValueError)         an environment variable that says none of its words
    ├── SetupFileError (ValueError)        an old robot.setup or world.setup that cannot be read: file, line
    ├── FaultPlanError (ValueError)        a plan of faults that cannot be used: file, rule, key, what was expected
    ├── MissionFileError (ValueError)      a mission's file that cannot be used: file, line or key, what was expected
    ├── ControlError (ValueError)          what a daemon's control socket was asked and cannot do
    ├── SnapshotError (ValueError)         a saved simulation that cannot be written, or read back
    ├── OutputFileError (ValueError)       a file that a run ends with and that cannot be written: file, why, remedy
    ├── EstimateFileError (ValueError)     a saved estimate that cannot be written, read back, or gone on from
    ├── ShellError (ValueError)            a line of the shell or of its scripts that cannot be done
    ├── RecordingError (ValueError)        a recording that cannot be written, read or followed: file, line
    └── ExtraMissing (ImportError)         what was asked for wants an extra that is not installed: how to install it

Rules: a message names the guilty and the remedy. Only capi turns these into FALSE and State[44].
"""

from __future__ import annotations

from typing import ClassVar

REFUSALS = {
    1: "unknown message type",
    2: "wrong number or range of values",
    3: "not connected to a robot",
    4: "not available on this robot",
    5: "not allowed by the setup or a limit, or another client drives the robot",
    6: "the real robot did not answer",
}
"""What the codes of an ERROR reply mean (PROTOCOL.md, section 1)."""


class NomadError(Exception):
    """The root of every error of this project. `usage`: of what was typed, so that the same again is no use."""

    usage: ClassVar[bool] = False


class AddressError(NomadError, ValueError):
    """An address that cannot be read, or whose scheme nobody here serves."""

    usage = True


class ConnectionLost(NomadError, ConnectionError):
    """The other end closed the connection, or there was nobody to connect to."""


class ReplyTimeout(NomadError, TimeoutError):
    """No whole answer came within the time set."""


class RobotRefused(NomadError):
    """The other end answered, and the answer is no.

    `command` is the C name of the call; `code` the number of the ERROR reply, None for a NAK on the
    robot's own line and for a call that this side refuses because the model cannot do it; `reason` says more where
    the code does not.
    """

    def __init__(self, command: str, code: int | None, reason: str = "") -> None:
        self.command = command
        self.code = code
        self.reason = reason
        if not reason:
            reason = "NAK" if code is None else REFUSALS.get(code, "a code nobody documents")
        super().__init__(f"{command} was refused: {reason}" + ("" if code is None else f" (error {code})"))

    def __reduce__(self) -> tuple[type[RobotRefused], tuple[str, int | None, str]]:
        return type(self), (self.command, self.code, self.reason)

    @property
    def is_nak(self) -> bool:
        """Whether the robot said no on its own line; the C library takes that for done."""
        return self.code is None and not self.reason


class BumperHit(NomadError):
    """A bumper began to touch while the robot moved, and st was sent at once; only where bumper_stop=1 is asked for.

    `command` is the C name of the call that was answered so; `bumpers` the numbers of those that touch.
    """

    def __init__(self, command: str, bumpers: tuple[int, ...]) -> None:
        self.command = command
        self.bumpers = bumpers
        numbers = ", ".join(map(str, bumpers))
        super().__init__(f"{command}: bumper {numbers} touches; the robot was told to stop")

    def __reduce__(self) -> tuple[type[BumperHit], tuple[str, tuple[int, ...]]]:
        return type(self), (self.command, self.bumpers)


class WireError(NomadError, ValueError):
    """Bytes that are no message, or values that no message can carry."""


class WorldFileError(NomadError, ValueError):
    """A world, model or setup file in TOML that cannot be used: the message names file, key and what was expected."""


class StartError(NomadError, ValueError):
    """A start pose that touches a wall or lies outside the world."""


class VariableError(NomadError, ValueError):
    """An environment variable has a value that is none of its words: which variable, which value, which words."""

    usage = True


class SetupFileError(NomadError, ValueError):
    """An old robot.setup or world.setup that cannot be used; the message names file, line and what was expected."""


class FaultPlanError(NomadError, ValueError):
    """A plan of faults that cannot be used; the message names file, rule, key and what was expected."""


class MissionFileError(NomadError, ValueError):
    """A mission's file that cannot be used; the message names file, line or key, and what was expected."""


class ControlError(NomadError, ValueError):
    """What was asked of a daemon's control socket and cannot be done; the message says what would be right."""


class SnapshotError(NomadError, ValueError):
    """A saved simulation that cannot be written or read back; the message names the file and what is wrong."""


class OutputFileError(NomadError, ValueError):
    """A file that is to be written at the end of a run cannot be, which is told before it begins where it shows then.
    """


class EstimateFileError(NomadError, ValueError):
    """A saved estimate that cannot be written, read back or gone on from; the message names the reason and the remedy.
    """


class ShellError(NomadError, ValueError):
    """A line of the shell or of one of its scripts that is no command, or cannot be done; the message says why."""


class RecordingError(NomadError, ValueError):
    """A recording that cannot be written, read, or followed by a program that asks for something else."""


class ExtraMissing(NomadError, ImportError):
    """What was asked for wants an extra of this distribution; the message says how to install it."""

    usage = True
