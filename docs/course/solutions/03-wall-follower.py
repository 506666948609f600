import math


def wall_on_the_right(side_in, ahead_in):
    side, ahead = 9.06 + side_in, 9.06 + ahead_in
    x, y = ahead * math.cos(math.radians(67.5)), side - ahead * math.sin(math.radians(67.5))
    angle = math.atan2(y, x)
    return side * math.cos(angle), angle


def turn_rate(distance_in, angle_rad, wanted_in):
    rate = 4 * (wanted_in - distance_in) + 80 * angle_rad
    return max(-30, min(30, rate))


def is_blocked(sonars_in, limit_in):
    return min(sonars_in[15], sonars_in[0], sonars_in[1]) < limit_in
