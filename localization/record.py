"""Record a drive to waypoints on the estimate of a filter, for notebooks, comparisons and `localization.plot`."""

from collections.abc import Callable, Sequence

from localization.filters.base import Filter, LocalizationConfig
from localization.filters.belief import independent
from localization.filters.registry import DEFAULT_METHOD
from localization.live.run import GroundTruth, Run
from localization.navigation.waypoints import Navigator, follow_waypoints, start_localizer
from nclient.robot import Robot


def record_run(
    robot: Robot,
    config: LocalizationConfig,
    waypoints: Sequence[tuple[float, float]],
    method: str | Filter = DEFAULT_METHOD,
    *,
    start_std: tuple[float, float, float] = (0.1, 0.1, 0.01),
    wait: Callable[[float], None] | None = None,
) -> Run:
    """Drive to waypoints on the estimate of a filter, and return the record of the run, for `localization.plot`.

    Parameters
    ----------
    robot : Robot
        It begins at the pose of its encoders. Of a simulated one the ground truth is recorded as well.
    config : LocalizationConfig
    waypoints : sequence of (x, y)
        Inches.
    method : str or Filter
        Name of a filter, `module:Class`, or a filter.
    start_std : tuple
        Standard deviation of the start: inches, inches, radians.
    wait : callable, optional
        Lets time of the robot pass; default: `Robot.sleep`.
    """
    state = robot.refresh()
    belief = independent([state.x_in, state.y_in, state.steering_rad], start_std)
    run, truth = Run([*waypoints]), GroundTruth(robot, robot.is_simulated())
    localizer = start_localizer(robot, config, belief, method)
    for step in follow_waypoints(robot, localizer, Navigator(run.waypoints), wait or robot.sleep):
        run.add(truth.moment(*step))
    return run
