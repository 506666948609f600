"""Drive to the middle of the room of figure 5.8, look in four directions, and return along given points."""

from localization.navigation.mission import Mission, OnLost, Settings, StepFailed

settings = Settings(title="Look around", map="several_walls", time_limit_s=300, on_lost=OnLost.SEARCH)


def mission(robot: Mission) -> None:
    robot.go_to(35, 55, limit_s=60, retries=1)
    for heading in (0, 90, 180, 270):
        robot.turn(heading)
        seen = robot.look()
        robot.note(f"{heading} deg: {seen.sonars_in[0]} in ahead, {seen.finds} unmapped obstacles")
    try:
        robot.wait_for(lambda seen: seen.nearest_in < 12, limit_s=3, words="waiting for a person")
        robot.note("a person is near")
    except StepFailed:
        robot.note("no person came")
    robot.follow([(20, 30), (5, 5)])
