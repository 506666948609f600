"""Missions that are programs in Python: run as a module, and its function `mission(robot)` as the mission.

    settings = Settings(title="Mail")           where it wants other ones

    def mission(robot):                         a plain function of one robot; it is done where it returns
        robot.go_to(60, 40)

Rules: whatever is wrong with a program is a MissionFileError with its file and, where there is one, its line: also that
it leaves by sys.exit, for then its exit code would be its own, 0 with nothing done. What is no mistake of the program
passes by: errors of the robot, the end of the mission, Ctrl-C and signals.
"""

from __future__ import annotations

import inspect
import traceback
from collections.abc import Callable
from typing import Any

from localization.missions.mission import Mission
from localization.missions.orders import Orders
from localization.missions.settings import Settings
from nclient.errors import MissionFileError, NomadError
from nclient.leaving import Left


def parse_program(text: str, file: str) -> Orders:
    """The mission that a program in Python says; `file` is what errors call it. Raises MissionFileError."""
    names: dict[str, Any] = {"__name__": "mission", "__file__": file}
    try:
        exec(compile(text, file, "exec"), names)
    except SyntaxError as error:
        raise MissionFileError(f"{file}: line {error.lineno}: is no Python: {error.msg}") from error
    except Left:
        raise
    except (Exception, SystemExit) as error:
        raise MissionFileError(_told(error, file)) from error
    act, settings = names.get("mission"), names.get("settings", Settings())
    if not callable(act):
        raise MissionFileError(f"{file}: expected a function mission(robot), found none; its verbs: docs/missions.md")
    _require_plain(act, file)
    if not isinstance(settings, Settings):
        raise MissionFileError(f"{file}: settings: expected Settings(...), found {type(settings).__name__}")

    def run(robot: Mission) -> None:
        try:
            _require_no_promise(act(robot), file)
        except MissionFileError as error:
            raise MissionFileError(_told(error, file)) from error
        except (NomadError, Left):
            raise
        except (Exception, SystemExit) as error:
            raise MissionFileError(_told(error, file)) from error

    return Orders(settings, run, f"{file}: settings: map")


def _require_plain(act: Callable[..., object], file: str) -> None:
    """Refuse what would return at once, with nothing done, and what cannot be called with a robot."""
    code = getattr(inspect.unwrap(act), "__code__", None)
    where = f"{file}: line {code.co_firstlineno}" if code is not None and code.co_filename == file else file
    called = act if inspect.isroutine(act) else getattr(act, "__call__", act)  # noqa: B004
    for kind, is_one in _KINDS.items():
        if is_one(act) or is_one(called):
            raise MissionFileError(f"{where}: expected a plain function mission(robot), found {kind}")
    try:
        inspect.signature(act).bind(None)
    except TypeError:
        found = f"mission{inspect.signature(act)}"
        raise MissionFileError(f"{where}: expected a function mission(robot) of one argument, found {found}") from None
    except ValueError:
        return  # of C, without a signature: what it takes shows when it is called


_KINDS: dict[str, Callable[[object], bool]] = {
    "async def": inspect.iscoroutinefunction,
    "an asynchronous generator": inspect.isasyncgenfunction,
    "a generator: it has a yield": inspect.isgeneratorfunction,
}


def _require_no_promise(came: object, file: str) -> None:
    """Refuse what a plain function got from an async one and did not wait for: nothing of it was done."""
    if inspect.iscoroutine(came):
        came.close()
        raise MissionFileError(f"{file}: expected mission(robot) to be done when it returns, found a coroutine")


def _told(error: BaseException, file: str) -> str:
    """An error of a program with the last line of the file that it came through."""
    lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == file]
    where = f"{file}: line {lines[-1]}" if lines else file
    if isinstance(error, MissionFileError):
        return f"{where}: {str(error).removeprefix(f'{file}: ')}"
    if isinstance(error, SystemExit):
        return f"{where}: leaves by SystemExit({error}); expected mission(robot) to return, or to raise StepFailed"
    return f"{where}: {type(error).__name__}: {error}"
