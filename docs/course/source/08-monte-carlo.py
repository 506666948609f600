# %% [markdown]
r"""
# 8 Monte Carlo localization

A grid over $x$, $y$ and heading has too many cells, and a Gaussian has only one peak. *Particles* are poses drawn
from the belief: where it is probable there are many of them. The filter (Fox, Burgard, Dellaert and Thrun 1999;
Probabilistic Robotics, section 8.3) repeats three steps:

1. **Move** each particle by the step of the encoders, with random errors of its own.
2. **Weigh** it by the density of the readings at its pose.
3. **Resample**: draw new particles with the weights as probabilities.
"""

# %% tags=["parameters"]
ADDRESS = "sim:several_walls?noisy=1&seed=5&start=0,57,0,0"
PARTICLES = 1000  # quick: 300
SECONDS = 30  # quick: 8

# %%
import math

import matplotlib.pyplot as plt
import numpy as np

from localization.course import check
from localization.course.lab import draw_map, expected_ranges, record
from worlds.io import load_world

# %% [markdown]
r"""
## Task 1: move

`particles` has a row x, y, heading for each particle. Return the moved ones. For a step of distance $d$ and turn $a$,
each particle draws its own distance with the variance $0.01\,|d|$ and its own turn with the variance $0.01\,|a| +
0.000025\,|d|$, and moves as in notebook 1. `rng.normal(mean, std, size)` draws Gaussian numbers.
"""

# %% tags=["task"]
def move_particles(particles, distance_in, turn_rad, rng):
    raise NotImplementedError


# %%
check(move_particles)

# %% [markdown]
r"""
## Task 2: weigh

`readings_in` are k readings, `expected_in` (n x k) what each of n particles expects. Multiply the old weights by the
densities of all readings, Gaussian with the standard deviation `std_in`, and normalize. Far from the truth densities
become smaller than the smallest number of the computer, 0 everywhere: add logarithms, and subtract the largest before
`np.exp`.
"""

# %% tags=["task"]
def weigh_particles(weights, readings_in, expected_in, std_in):
    raise NotImplementedError


# %%
check(weigh_particles)

# %% [markdown]
"""
## Task 3: resample

Return n indices of particles, drawn with the weights as probabilities. A particle may be drawn several times.
"""

# %% tags=["task"]
def resample(weights, rng):
    raise NotImplementedError


# %%
check(resample)

# %% [markdown]
r"""
## Task 4: the mean

Return the weighted mean pose. Mind the heading: the mean of 359° and 1° is 0°, not 180°. Take the direction of the
mean of $(\cos\theta, \sin\theta)$.
"""

# %% tags=["task"]
def mean_pose(particles, weights):
    raise NotImplementedError


# %%
check(mean_pose)

# %% [markdown]
"""
## Localize

The start is given within 15 in and 0.3 rad. Once a second the particles move and are weighed by the eight sonars with
even numbers. A standard deviation of 4 in is far more than the noise of a sonar: with few particles, none is exactly
right, and readings are up to half a second old. Readings of 255 are left out.
"""

# %%
def wander(state):
    ahead = min(state.sonars_in[k] for k in (14, 0, 2))
    return (0, 20) if ahead < 16 else (6, 0)


drive = record(ADDRESS, wander, SECONDS, sonars=range(0, 16, 2))
room = load_world("several_walls")
rng = np.random.default_rng(0)
SONARS = np.arange(0, 16, 2)


def step_between(before, after):
    turn = math.remainder(after[2] - before[2], math.tau)
    angle = before[2] + turn / 2
    return (after[0] - before[0]) * math.cos(angle) + (after[1] - before[1]) * math.sin(angle), turn


particles = rng.normal(drive.encoders[0], (15, 15, 0.3), (PARTICLES, 3))
weights = np.full(PARTICLES, 1 / PARTICLES)
clouds, means, rows = [particles], [mean_pose(particles, weights)], range(0, len(drive.encoders), 10)
for before, row in zip(rows, rows[1:]):
    particles = move_particles(particles, *step_between(drive.encoders[before], drive.encoders[row]), rng)
    valid = drive.sonars_in[row, SONARS] < 255
    turret = drive.turret_rad[row] - drive.encoders[row, 2]
    expected = expected_ranges(particles, turret + SONARS[valid] * np.pi / 8, room)
    weights = weigh_particles(weights, drive.sonars_in[row, SONARS[valid]], expected, 4)
    means.append(mean_pose(particles, weights))
    chosen = np.asarray(resample(weights, rng))
    particles, weights = np.asarray(particles)[chosen], np.full(PARTICLES, 1 / PARTICLES)
    clouds.append(particles)
means = np.array(means)

# %%
figure, axes = plt.subplots(figsize=(6.5, 6.5))
draw_map(axes, room)
for k in (0, 1, 4, len(clouds) - 1):
    axes.plot(*clouds[k][:, :2].T, ".", markersize=2, label=f"after {k} s")
axes.plot(*means[:, :2].T, "r--", label="mean")
axes.plot(*drive.truth[:, :2].T, "k-", linewidth=1, label="truth")
axes.legend(loc="upper left", markerscale=4)
plt.show()
errors = np.hypot(*(means - drive.truth[rows])[:, :2].T)
print(f"error at the start {errors[0]:.1f} in, at the end {errors[-1]:.1f} in")

# %% [markdown]
"""
Try 50 particles, and a standard deviation of 0.5 in instead of 4. Why does the better model of the sonar make a worse
filter?
"""
