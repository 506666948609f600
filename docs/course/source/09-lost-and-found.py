# %% [markdown]
r"""
# 9 Lost and found

A filter that tracks a pose cannot notice by itself that it is wrong: its particles are all in one place, and one of
them is always the best. Two problems are harder than tracking (Probabilistic Robotics, section 7.1):

- **Global localization**: the robot does not know where it starts.
- **The kidnapped robot**: it is carried elsewhere and believes that it is still where it was.

The remedy is to add random particles when readings fit worse than they used to. Compare a fast with a slow average of
the readings' likelihood (augmented Monte Carlo localization, Probabilistic Robotics, table 8.3).
"""

# %% tags=["parameters"]
ADDRESS = "sim:several_walls?noisy=1&seed=7&start=0,57,0,0"
PARTICLES = 3000  # quick: 400
SECONDS = 60  # quick: 12

# %%
import math

import matplotlib.pyplot as plt
import numpy as np

from localization.course import check
from localization.course.lab import draw_map, expected_ranges, record
from worlds.io import load_world

# %% [markdown]
r"""
## Task 1: how many particles matter?

The effective number of particles is $1 / \sum_i w_i^2$ for weights that sum to 1 (Liu 1996). Equal weights of n
particles give n; one weight of 1 gives 1.
"""

# %% tags=["task"]
def effective_number(weights):
    raise NotImplementedError


# %%
check(effective_number)

# %% [markdown]
r"""
## Task 2: the fraction of random particles

`likelihood` is how well the readings fit, `slow` and `fast` are its averages so far. Update both by $\text{average}
\leftarrow \text{average} + \text{rate}\,(\text{likelihood} - \text{average})$ with the rates 0.05 (slow) and 0.5
(fast). Return the new slow, the new fast, and the fraction $\max(0,\, 1 - \text{fast}/\text{slow})$ from the new
ones.
"""

# %% tags=["task"]
def random_fraction(slow, fast, likelihood):
    raise NotImplementedError


# %%
check(random_fraction)

# %% [markdown]
"""
## Task 3: found?

Return True if at least 95 % of the weight belongs to particles that are at most `within_in` inches from the weighted
mean position.
"""

# %% tags=["task"]
def is_found(particles, weights, within_in):
    raise NotImplementedError


# %%
check(is_found)

# %% [markdown]
"""
## A drive with a kidnapping

`wander` drives ahead and turns away from walls. In the middle of the drive we cut some seconds out of what the filter
gets: for the filter, the robot was carried away with its sensors off. This works with a real robot as well.
"""

# %%
def wander(state):
    ahead = min(state.sonars_in[k] for k in (14, 0, 2))
    return (0, 20) if ahead < 16 else (6, 0)


drive = record(ADDRESS, wander, SECONDS, sonars=range(0, 16, 2))
n = len(drive.encoders)
rows = [row for row in range(0, n, 10) if not 0.4 * n < row < 0.6 * n]
room = load_world("several_walls")
SONARS = np.arange(0, 16, 2)


def random_poses(count, rng):
    """Return poses anywhere in the room."""
    low, high = room.walls.reshape(-1, 2).min(axis=0) + 10, room.walls.reshape(-1, 2).max(axis=0) - 10
    return np.column_stack((rng.uniform(low, high, (count, 2)), rng.uniform(0, math.tau, count)))


def step_between(before, after):
    turn = math.remainder(after[2] - before[2], math.tau)
    angle = before[2] + turn / 2
    return (after[0] - before[0]) * math.cos(angle) + (after[1] - before[1]) * math.sin(angle), turn


# %% [markdown]
r"""
The filter is that of notebook 8, with two changes. A reading may be random, with the probability 0.1, so its density
is a Gaussian plus a constant. And `fit`, the geometric mean of the densities that the particles expect, decides how
many particles are replaced by random poses.
"""

# %%
def localize(with_random):
    rng = np.random.default_rng(1)
    particles, weights = random_poses(PARTICLES, rng), np.full(PARTICLES, 1 / PARTICLES)
    slow = fast = 0.0
    history = []
    for before, row in zip(rows, rows[1:]):
        # 1. Move; where something is cut out, the filter sees no step at all.
        distance, turn = step_between(*drive.encoders[[before, row]]) if row - before == 10 else (0, 0)
        distance = distance + rng.normal(0, 0.3 + 0.1 * abs(distance), PARTICLES)
        turn = turn + rng.normal(0, 0.03 + 0.1 * abs(turn), PARTICLES)
        angle = particles[:, 2] + turn / 2
        particles = particles + np.column_stack((distance * np.cos(angle), distance * np.sin(angle), turn))
        # 2. Weigh by the eight sonars.
        directions = drive.turret_rad[row] - drive.encoders[row, 2] + SONARS * np.pi / 8
        expected, z = expected_ranges(particles, directions, room), drive.sonars_in[row, SONARS]
        density = 0.9 * np.exp(-0.5 * ((z - expected) / 3) ** 2) + 0.1 * 3 * math.sqrt(math.tau) / 255
        fit = math.exp(weights @ np.log(density).mean(axis=1))
        weights = density.prod(axis=1)
        weights /= weights.sum()
        # 3. Record, then resample and add random poses.
        mean = weights @ particles[:, :2]
        error = math.dist(mean, drive.truth[row][:2])
        slow, fast, fraction = random_fraction(slow or fit, fast or fit, fit)
        found = is_found(particles, weights, 12)
        history.append((drive.clock_s[row], error, effective_number(weights), fraction, found))
        particles = particles[rng.choice(PARTICLES, PARTICLES, p=weights)]
        if with_random:
            replaced = rng.uniform(size=PARTICLES) < min(fraction, 0.5)
            particles[replaced] = random_poses(int(replaced.sum()), rng)
        weights = np.full(PARTICLES, 1 / PARTICLES)
    return np.array(history, dtype=float)


runs = {"tracking only": localize(False), "with random particles": localize(True)}

# %%
figure, (error, number, fraction) = plt.subplots(3, 1, figsize=(9, 8), sharex=True)
for name, rows_of_run in runs.items():
    # A row without values makes a gap in the lines.
    gap = np.searchsorted(rows_of_run[:, 0], drive.clock_s[n // 2])
    history = np.insert(rows_of_run, gap, np.nan, axis=0)
    clock_s = history[:, 0]
    error.plot(clock_s, history[:, 1], ".-", label=name)
    number.semilogy(clock_s, history[:, 2])
    fraction.plot(clock_s, history[:, 3])
    found = history[:, 4] > 0
    level = -3 if name == "tracking only" else -6
    error.plot(clock_s[found], np.full(found.sum(), level), "|", color=error.lines[-1].get_color())
for axes in (error, number, fraction):
    axes.axvspan(drive.clock_s[int(0.4 * n)], drive.clock_s[int(0.6 * n)], color="0.9")
error.set(ylabel="error (in)", title="grey: carried away; ticks below 0: is_found")
error.legend()
number.set(ylabel="effective number")
fraction.set(ylabel="random fraction", xlabel="time (s)")
plt.show()
for name, history in runs.items():
    print(f"{name}: error {history[-5:, 1].mean():.1f} in during the last seconds")

# %% [markdown]
"""
Both find the robot at the start: a few readings leave only one place. After the kidnapping only the
second recovers. `is_found` is a statement about the particles, not about the truth: look at what the first one says
while it is wrong. The random fraction stays high for a while, since the slow average still contains the better fits
before, and random particles fit badly themselves.

The built-in finder works without particles ([Methods](../methods.md)): `nomad localize
"sim:several_walls?noisy=1&seed=7" --start unknown --waypoints 40,20`.
"""
