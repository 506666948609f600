# %% [markdown]
r"""
# 7 Association and gating

A reading does not say which wall it comes from. Before a filter can use it, it must decide: this is *data
association*. A wrong decision is worse than none, since the filter becomes sure of a wrong pose. Three tools:

- **Distance.** How many standard deviations off is a reading? The squared Mahalanobis distance is $\nu^\top S^{-1}
  \nu$, with the innovation $\nu$ and its covariance $S$. If all is well, it is chi-square distributed.
- **Gate.** Readings above a bound are not used. For one dimension, 9 lets 99.7 % of the right ones pass.
- **Probabilities.** Where several walls explain a reading, each gets a weight (Bar-Shalom and Fortmann, *Tracking and
  Data Association*, 1988).
"""

# %% tags=["parameters"]
ADDRESS = "sim:several_walls?setup=measured&seed=2&start=0,57,0,0"
SECONDS = 24  # quick: 6

# %%
import math

import matplotlib.pyplot as plt
import numpy as np

from localization.course import check
from localization.course.lab import RING_IN, SONAR_RAD, draw_map, record
from worlds.io import load_world

# %% [markdown]
"""
## Task 1: distance

Return the squared Mahalanobis distance of an innovation (a vector) with the covariance S (a matrix).
"""

# %% tags=["task"]
def mahalanobis2(innovation, S):
    raise NotImplementedError


# %%
check(mahalanobis2)

# %% [markdown]
"""
## Task 2: the nearest neighbour

Several reflectors could have returned an echo. `expected_in` are their ranges, `variances` those of the innovations.
Return the number of the one that is nearest in standard deviations, or -1 if even its squared distance is above the
gate.
"""

# %% tags=["task"]
def nearest_reflector(reading_in, expected_in, variances, gate):
    raise NotImplementedError


# %%
check(nearest_reflector)

# %% [markdown]
r"""
## Task 3: probabilities

Return the probabilities of all explanations of a reading: one for each of the $m$ reflectors, and last that it is
random. Before the reading all reflectors are equally probable, $(1 - p)/m$ each, and a random reading has the
probability $p$ and the density $1/255$:

$$
w_i = \frac{1 - p}{m}\, \frac{1}{\sqrt{2 \pi S_i}}\, e^{-\nu_i^2 / 2 S_i}, \qquad w_0 = \frac{p}{255}
$$

Divide them by their sum.
"""

# %% tags=["task"]
def association_probabilities(innovations, variances, p_random):
    raise NotImplementedError


# %%
check(association_probabilities)

# %% [markdown]
"""
## Which wall was it?

The robot drives slowly through a room with inner walls, with the acoustics of a real ring. A wall returns an echo if
its perpendicular lies in the cone of the sonar; an edge returns one from any direction, but a weak one. So each
reading has a few candidates: walls with a foot point in the cone, and ends of walls in it. The pose is the true one
here (with a real robot: that of the encoders), so what does not fit is not the pose's fault.
"""

# %%
drive = record(ADDRESS, [(3, 0, SECONDS)])
room = load_world("several_walls")
CONE = math.radians(12.5)


def candidates(origin, direction):
    """Return points that may reflect sound to a sonar: foot points of walls in its cone, and ends of walls."""
    begin, end = room.walls[:, :2], room.walls[:, 2:]
    along = end - begin
    t = np.sum((origin - begin) * along, axis=1) / np.sum(along**2, axis=1)
    feet = (begin + t[:, None] * along)[(t > 0) & (t < 1)]
    points = np.vstack((feet, begin[4:], end))  # rows 0 to 3: the outline
    bearing = np.arctan2(*(points - origin).T[::-1]) - direction
    return points[np.abs((bearing + np.pi) % (2 * np.pi) - np.pi) < CONE]


poses = drive.truth if drive.has_truth else drive.encoders
turrets = poses[:, 2] + drive.turret_rad - drive.encoders[:, 2]
explained, odd = [], []
for (x, y, _), turret, readings in zip(poses[::5], turrets[::5], drive.sonars_in[::5]):
    for direction, reading in zip(turret + SONAR_RAD, readings):
        if not 6 < reading < 255:
            continue
        origin = np.array([x, y]) + RING_IN * np.array([math.cos(direction), math.sin(direction)])
        points = candidates(origin, direction)
        ranges = np.hypot(*(points - origin).T)
        found = -1
        if len(points):
            found = nearest_reflector(reading, ranges, 0.5 + (0.02 * ranges) ** 2, 9.0)
        if found >= 0:
            explained.append(points[found])
        else:
            odd.append(origin + reading * np.array([math.cos(direction), math.sin(direction)]))
print(f"{len(explained)} readings explained, {len(odd)} not")

# %%
figure, axes = plt.subplots(figsize=(6, 6))
draw_map(axes, room)
axes.plot(*poses[:, :2].T, "k-", linewidth=1)
axes.plot(*np.array(explained).T, ".", label="explained: the reflector")
if odd:
    axes.plot(*np.array(odd).T, "rx", markersize=4, label="not explained: on the sonar's axis")
axes.set(xlim=(-30, 120), ylim=(-30, 120))
axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0))
plt.show()

# %% [markdown]
"""
Some of the readings that nothing explains are old: a sonar fires once a second, and the robot has moved by up to 3 in
since. Others are echoes over several walls, which are longer than the direct ones. A filter must reject both, or
model them. A reading that two candidates explain is divided among them by their probabilities:
"""

# %%
for innovations in ([0.3, 4.0], [0.3, 0.9], [6.0, 7.0]):
    p = association_probabilities(np.array(innovations), np.array([1.0, 1.0]), 0.1)
    print(f"innovations {innovations}: {p[0]:.0%} and {p[1]:.0%}, random {p[2]:.0%}")
