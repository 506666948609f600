# %% [markdown]
r"""
# 2 What a sonar measures

A sonar sends a chirp of ultrasound and measures the time until the first echo. A Nomad has sixteen, in a ring of
radius $r = 9.06$ in around its turret; sonar $i$ looks in the direction $i \cdot 22.5°$ counter-clockwise from sonar
0. A reading is a range in whole inches from the ring; 255 means that there was no echo.

Two models are in use. The simple one takes a sonar for a *ray*: the reading is the range along its axis. In reality
sound spreads in a *cone* of some 25°, and smooth walls reflect it as mirrors do: only what is perpendicular to the
sound returns an echo. This notebook shows both (Leonard and Durrant-Whyte, *Directed Sonar Sensing*, 1992).
"""

# %% tags=["parameters"]
ADDRESS = "sim:thesis_room?noisy=1&seed=1&start=25,35,0,0"
TURN_S = 16  # quick: 3
READINGS = 400  # quick: 30

# %%
import math

import matplotlib.pyplot as plt
import numpy as np

from localization.course import check
from localization.course.lab import draw_map, record
from worlds.io import load_world

room = load_world("thesis_room")

# %% [markdown]
"""
## Task 1: where a sonar looks

Sonars turn with the turret. Return the direction of a sonar in the room, in radians.
"""

# %% tags=["task"]
def sonar_direction(turret_rad, number):
    raise NotImplementedError


# %%
check(sonar_direction)

# %% [markdown]
"""
## Task 2: the point of an echo

Return x and y of the point that a reading would mean if the sonar were a ray. The robot's axis is at (x, y).
"""

# %% tags=["task"]
def echo_point(x, y, turret_rad, number, reading_in):
    raise NotImplementedError


# %%
check(echo_point)

# %% [markdown]
"""
## Rays and cones

The robot turns on the spot by the angle between two sonars, slowly: the sixteen sonars fire one after the other, and
a round takes a second. Left: the readings of `ADDRESS`, simulated as rays. Right: the same with the acoustics of a
real ring (`setup=measured`). Points of the right picture lie on arcs: whatever the direction of the sonar within the
cone, the echo is that of the nearest point of the wall, so the range stays the same. Between the arcs there are no
echoes, and corners, where two walls meet, return some.
"""

# %%
turn = [(0, 1.5, TURN_S)]
drives = {"rays": record(ADDRESS, turn), "cones": record("sim:thesis_room?setup=measured&seed=1&start=25,35,0,0", turn)}
figure, columns = plt.subplots(1, 2, figsize=(10, 5))
for axes, (name, drive) in zip(columns, drives.items()):
    draw_map(axes, room)
    points = [
        echo_point(x, y, turret, number, reading)
        for (x, y, _), turret, sonars in zip(drive.encoders, drive.turret_rad, drive.sonars_in)
        for number, reading in enumerate(sonars)
        if reading < 255
    ]
    axes.plot(*np.array(points).T, ".", markersize=2)
    axes.set(title=name, xlim=(-30, 120), ylim=(-30, 120))
plt.show()

# %% [markdown]
r"""
## Task 3: the range to a wall

A filter compares readings with expected ranges. Return the range along a ray from the point (x, y) to a wall `(x1, y1,
x2, y2)`. Return `math.inf` if the ray misses the wall, passes its end, or the wall lies behind.

With $c = \cos\varphi$, $s = \sin\varphi$ of the ray's direction, each end of the wall has a coordinate along the ray
and one to the left of it:

$$
a_i = c\,(x_i - x) + s\,(y_i - y), \qquad b_i = c\,(y_i - y) - s\,(x_i - x)
$$

The ray's line meets the wall if $b_1$ and $b_2$ have different signs, and it does so at $(a_1 b_2 - a_2 b_1) / (b_2 -
b_1)$.
"""

# %% tags=["task"]
def range_to_wall(x, y, direction_rad, wall):
    raise NotImplementedError


# %%
check(range_to_wall)

# %% [markdown]
"""
The nearest wall counts. Compare the first readings with what your function expects:
"""

# %%
drive = drives["rays"]
(x, y, _), turret = drive.encoders[0], drive.turret_rad[0]
for number in range(0, 16, 2):
    expected = min(range_to_wall(x, y, sonar_direction(turret, number), wall) for wall in room.walls) - 9.06
    print(f"sonar {number:2}: expected {expected:5.1f} in, measured {drive.sonars_in[0][number]:3.0f} in")

# %% [markdown]
r"""
## Task 4: how exact is a reading?

The simulated noise is Gaussian, with a standard deviation of one per cent of the range, and readings are rounded to
whole inches. An error that is uniform over one inch has the variance $1/12$. Return the standard deviation of a
reading.
"""

# %% tags=["task"]
def reading_std(range_in):
    raise NotImplementedError


# %%
check(reading_std)

# %% [markdown]
"""
Many readings of sonar 0, which alone fires now, while the robot creeps to the wall. The errors lie in the band,
mostly. Errors of consecutive readings look alike: rounding repeats itself where the range hardly changes. This needs
the ground truth, so it is always simulated.
"""

# %%
creep = record("sim:thesis_room?noisy=1&seed=3&start=0,45,0,0", [(1.5, 0, READINGS / 10)], sonars=[0])
ranges = np.array([range_to_wall(x, y, heading, room.walls[1]) - 9.06 for x, y, heading in creep.truth])
errors = creep.sonars_in[:, 0] - ranges
band = np.array([2 * reading_std(each) for each in ranges])
figure, axes = plt.subplots(figsize=(8, 4))
axes.plot(ranges, errors, ".", markersize=3)
axes.fill_between(ranges, -band, band, alpha=0.2, label="two standard deviations")
axes.set(xlabel="true range (in)", ylabel="reading minus range (in)")
axes.set_title(f"{np.mean(abs(errors) < band):.0%} in the band")
axes.legend()
plt.show()
