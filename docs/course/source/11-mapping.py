# %% [markdown]
r"""
# 11 Mapping

Until now the map was given. Here the pose is known, and the map is not. An *occupancy grid* (Moravec and Elfes 1985;
Probabilistic Robotics, chapter 9) divides the floor into cells, each with a probability of being occupied. Cells are
taken to be independent, so each is a Bayes filter of its own, and in log odds

$$
l = \log \frac{p}{1 - p}
$$

Bayes' rule is an addition: $l \leftarrow l + \log \frac{p(z)}{1 - p(z)}$, where $p(z)$ is the probability of the cell
given this one reading. $l = 0$ means that nothing is learnt.
"""

# %% tags=["parameters"]
ADDRESS = "sim:several_walls?setup=measured&seed=3&start=0,57,0,0"
SECONDS = 120  # quick: 6

# %%
import matplotlib.pyplot as plt
import numpy as np

from localization.course import check
from localization.course.lab import RING_IN, SONAR_RAD, draw_map, record
from worlds.io import load_world

# %% [markdown]
"""
## Task 1: a cell

Return the log odds of cells after a reading that gives them the probabilities p. Both arguments are arrays of the same
shape, a number for each cell; `np.log` takes arrays, `math.log` does not.
"""

# %% tags=["task"]
def update_cell(log_odds, p):
    raise NotImplementedError


# %%
check(update_cell)

# %% [markdown]
r"""
## Task 2: what a reading says about cells

Arrays `distances_in` and `angles_rad` say where cells are: distances from the sonar, angles against its axis. Return
an array of probabilities:

- 0.5 outside of the cone (more than 12.5° off the axis) and behind the arc: nothing is learnt;
- 0.35 in the cone before the arc, that is nearer than the reading by more than 2 in: probably free;
- 0.7 in the cone on the arc, within 2 in of the reading: something on the arc returned the echo, at an unknown place;
- 0.5 everywhere if the reading is 255: a slanted smooth wall returns no echo, so no echo does not mean free.
"""

# %% tags=["task"]
def inverse_sensor(distances_in, angles_rad, reading_in):
    raise NotImplementedError


# %%
check(inverse_sensor)

# %% [markdown]
"""
## Drive and fill the grid

The robot wanders, slowly: readings are up to a second old. So those of its turns are left out as well. Its poses are
the true ones, or those of the encoders if there is no ground truth: then walls become blurred as the odometry drifts.
"""

# %%
def wander(state):
    ahead = min(state.sonars_in[k] for k in (14, 15, 0, 1, 2))
    return (0, 25) if ahead < 16 else (4, 0)


drive = record(ADDRESS, wander, SECONDS)
poses = drive.truth if drive.has_truth else drive.encoders
turrets = poses[:, 2] + drive.turret_rad - drive.encoders[:, 2]

# %%
CELL_IN = 2
axis = np.arange(-20, 112, CELL_IN) + CELL_IN / 2
X, Y = np.meshgrid(axis, axis)
grid = np.zeros(X.shape)
for row in range(10, len(poses), 10):
    (x, y, _), turret, readings = poses[row], turrets[row], drive.sonars_in[row]
    if abs(drive.turret_rad[row] - drive.turret_rad[row - 10]) > 0.02:
        continue
    for direction, reading in zip(turret + SONAR_RAD, readings):
        dx, dy = X - x - RING_IN * np.cos(direction), Y - y - RING_IN * np.sin(direction)
        angles = (np.arctan2(dy, dx) - direction + np.pi) % (2 * np.pi) - np.pi
        grid = update_cell(grid, inverse_sensor(np.hypot(dx, dy), angles, reading))

# %%
room = load_world("several_walls")
figure, (left, right) = plt.subplots(1, 2, figsize=(11, 5))
for axes in (left, right):
    axes.imshow(1 / (1 + np.exp(-grid)), origin="lower", cmap="Greys", vmin=0, vmax=1, extent=(-20, 112, -20, 112))
    axes.set(xlabel="x (in)", ylabel="y (in)")
left.set_title("occupied: black, free: white, unknown: grey")
draw_map(right, room)
right.plot(*poses[:, :2].T, "r-", linewidth=0.7)
right.set_title("with the true walls and the path")
plt.show()

# %% [markdown]
r"""
## Task 3: from points to a wall

A filter wants lines. Fit the line $x \cos\alpha + y \sin\alpha = \rho$ to points (n x 2) so that the sum of squared
distances *across the line* is smallest, for walls of any direction. Return $\alpha$ and $\rho$. The normal
$(\cos\alpha, \sin\alpha)$ is the eigenvector of the points' covariance (`np.cov(points.T)`, `np.linalg.eigh`) with
the smaller eigenvalue, and the line goes through the mean of the points.
"""

# %% tags=["task"]
def fit_wall(points):
    raise NotImplementedError


# %%
check(fit_wall)

# %% [markdown]
"""
Echoes of the outer wall on the left, x = -12 in: cells near it that are probably occupied.
"""

# %%
occupied = np.column_stack((X[grid > 0.5], Y[grid > 0.5]))
points = occupied[occupied[:, 0] < -4]
if len(points) > 2:
    alpha, rho = fit_wall(points)
    print(f"{len(points)} cells: alpha {np.degrees(alpha):.1f} deg, rho {rho:.1f} in; the wall is at x = -12 in")

# %% [markdown]
"""
Cells take each reading for new information, although a sonar that looks at the same wall from almost the same place
adds almost nothing. `nomad map learn` estimates poses, walls and the errors of wheels and sonars together, without
any given pose ([Learn a map](../mapping.md)).
"""
