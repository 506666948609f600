"""A robot that presses against an obstacle rolls on the spot."""

from __future__ import annotations

from localization.live.sensor_input import SensorData, SlipCorrection


def state(clock_s: float, x_in: float, touching: bool) -> SensorData:
    return SensorData(clock_s, x_in, 3.0, 0.0, 0.0, (255.0,) * 16, touching)


def test_only_what_is_rolled_on_the_spot_is_left_out() -> None:
    slip = SlipCorrection()
    # Free at 5 in/s; then pressed, the wheels creep by 0.1 in each; then away at 5 in/s with the bumper still closed.
    states = [state(0.0, 0.0, False), state(0.1, 0.5, False), state(0.2, 1.0, True), state(0.3, 1.1, True)]
    states += [state(0.4, 1.2, True), state(0.5, 0.7, True), state(0.6, 0.2, False)]
    positions = [round(slip.position_of(one)[0], 6) for one in states]
    assert positions == [0.0, 0.5, 1.0, 1.0, 1.0, 0.5, 0.0]
    assert slip.position_of(state(0.7, 0.2, False))[1] == 3.0
