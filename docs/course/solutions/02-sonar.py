import math


def sonar_direction(turret_rad, number):
    return turret_rad + number * math.pi / 8


def echo_point(x, y, turret_rad, number, reading_in):
    direction = turret_rad + number * math.pi / 8
    return x + (9.06 + reading_in) * math.cos(direction), y + (9.06 + reading_in) * math.sin(direction)


def range_to_wall(x, y, direction_rad, wall):
    x1, y1, x2, y2 = wall
    c, s = math.cos(direction_rad), math.sin(direction_rad)
    ahead1, side1 = c * (x1 - x) + s * (y1 - y), c * (y1 - y) - s * (x1 - x)
    ahead2, side2 = c * (x2 - x) + s * (y2 - y), c * (y2 - y) - s * (x2 - x)
    if side1 * side2 > 0 or side1 == side2:
        return math.inf
    range_in = (ahead1 * side2 - ahead2 * side1) / (side2 - side1)
    return range_in if range_in > 0 else math.inf


def reading_std(range_in):
    return math.sqrt((0.01 * range_in) ** 2 + 1 / 12)
