# %% [markdown]
r"""
# 3 A wall follower

A robot without a map can still do something useful: follow a wall on its right at a constant distance. This needs
feedback. The robot measures how far it is from the wall and at which angle it drives, and turns so that both become
right.

With the distance $\delta$ from the wall, the angle $\varphi$ of the wall against the robot's heading (positive if the
wall turns to the left, into the path) and the speed $v$, the motion along a straight wall is

$$
\dot\delta = -v \sin\varphi, \qquad \dot\varphi = -\omega
$$

where $\omega$ is the turn rate, positive to the left. Turning in proportion to the error of $\delta$ alone makes the
robot swing for ever, like a pendulum without friction: a term with $\varphi$ is its damper (Åström and Murray,
*Feedback Systems*, 2008, section 10.1: derivative action).
"""

# %% tags=["parameters"]
ADDRESS = "sim:thesis_room?noisy=1&seed=1&start=20,15,0,0"
SECONDS = 70  # quick: 8
DISTANCE_IN = 20

# %%
import math

import matplotlib.pyplot as plt
import numpy as np

from localization.course import check
from localization.course.lab import draw_map, record
from worlds.io import load_world

# %% [markdown]
r"""
## Task 1: distance and angle of the wall

Sonar 12 looks to the right ($-90°$), sonar 13 half ahead ($-67.5°$). Both ranges begin at the ring, 9.06 in from the
axis. Take them for rays: then each gives a point of the wall in the robot's frame (x ahead, y to the left), and the
two points give the wall. Return its distance from the axis, perpendicular to the wall, and its angle $\varphi$ in
radians.

Hint: the direction of the wall is `math.atan2(dy, dx)` of the difference of both points, that of sonar 13 minus that
of sonar 12. The distance is that of the point of sonar 12 from the axis, times $\cos\varphi$.
"""

# %% tags=["task"]
def wall_on_the_right(side_in, ahead_in):
    raise NotImplementedError


# %%
check(wall_on_the_right)

# %% [markdown]
"""
## Task 2: the control law

Return the turn rate in degrees per second, positive to the left and limited to ±30. The check lets a robot drive
along a simulated wall at 6 in/s, from several distances: after 30 s it must be within 1 in of the wanted distance and
parallel to the wall within 0.1 rad, without having touched the wall.
"""

# %% tags=["task"]
def turn_rate(distance_in, angle_rad, wanted_in):
    raise NotImplementedError


# %%
check(turn_rate)

# %% [markdown]
"""
## Task 3: stop before the corner

`sonars_in` has all sixteen readings. Return True if at least one of the three sonars ahead (15, 0 and 1) reads less
than the limit.
"""

# %% tags=["task"]
def is_blocked(sonars_in, limit_in):
    raise NotImplementedError


# %%
check(is_blocked)

# %% [markdown]
"""
## Drive

`steer` is called with each state and returns the speed (in/s) and the turn rate (deg/s). Before a corner the robot
turns to the left on the spot. While it turns, both sonars may look at different walls, and the angle would be huge:
it is limited.
"""

# %%
def steer(state):
    if is_blocked(state.sonars_in, DISTANCE_IN + 5):
        return 0, 30
    distance, angle = wall_on_the_right(state.sonars_in[12], state.sonars_in[13])
    return 6, turn_rate(min(distance, 2 * DISTANCE_IN), max(-0.5, min(0.5, angle)), DISTANCE_IN)


drive = record(ADDRESS, steer, SECONDS, sonars=[0, 12, 13, 1, 12, 13, 15, 12, 13])

# %%
room = load_world("thesis_room")
path = drive.truth if drive.has_truth else drive.encoders
nearest = [room.clearance(x, y) for x, y, _ in path]
figure, (plan, distance) = plt.subplots(1, 2, figsize=(11, 4.5))
draw_map(plan, room)
plan.plot(*path[:, :2].T)
distance.plot(drive.clock_s, nearest)
distance.axhline(DISTANCE_IN, linestyle="--", color="0.4")
distance.set(xlabel="time (s)", ylabel="distance from the nearest wall (in)", ylim=(0, None))
plt.show()

# %% [markdown]
"""
Try other gains and another distance, and the world `several_walls`, in which walls end: what should the robot do
there? Then try `setup=measured` in the address: cones show the nearest point of a wall, so sonar 13 reads less than a
ray would, or nothing. Which formula for distance and angle suits cones?
"""
