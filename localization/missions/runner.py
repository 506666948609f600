"""A mission from its first step to its report, whatever happens.

    done                        every step was
    a word of a failure         a step failed, and the program did not catch it; or time, fence, LOST, caught or not
    error, interrupted          the robot or the file failed; Ctrl-C, SIGTERM, SIGHUP. Both are told in the report, and
                                raised again

Rules: no options, no printing. The helm stops the robot.
"""

from __future__ import annotations

from collections.abc import Callable

from localization.missions.mission import Mission
from localization.missions.report import DONE, MissionOver, StepFailed, ending_of


def run_mission(mission: Mission, act: Callable[[Mission], object]) -> None:
    """Run it; `mission.report` says how it ended. Raises what is no failure of a step."""
    report = mission.report
    try:
        act(mission)
        if mission.ended is not None:
            raise mission.ended
        report.ending, report.reason = DONE, ""
    except (StepFailed, MissionOver) as failure:
        report.ending, report.reason = ending_of(failure)
    except BaseException as error:
        report.ending, report.reason = ending_of(error)
        raise
    finally:
        if isinstance(mission.ended, MissionOver):
            report.ending, report.reason = mission.ended.ending, str(mission.ended)
        report.duration_s = mission.seen.clock_s
