# %% [markdown]
r"""
# 1 Encoders and odometry

The wheels of a robot turn encoders. Adding up what they count gives a pose: *odometry*, or *dead reckoning*. It is
always there, it is smooth, and its error grows without bound. This notebook computes it, and measures how fast it
goes wrong.

A step of the encoders is a distance $d$ along the heading and a turn $a$. From the pose $(x, y, \theta)$ it leads to

$$
x' = x + d \cos(\theta + a/2), \qquad y' = y + d \sin(\theta + a/2), \qquad \theta' = \theta + a
$$

The robot turns while it drives, so the heading while driving is, on average, that at half of the turn. (Thrun, Burgard
and Fox, *Probabilistic Robotics*, 2005, section 5.4, have one turn before and one after the distance; here each is half
of $a$.) Lengths are inches, angles radians, counter-clockwise positive; heading 0 looks along x.

`ADDRESS` decides which robot drives: one simulated in this process, a recording (`replay:out/drive.log`, made with
`&record=out/drive.log` at the end of a simulated robot's address), or a real one (`serial:///dev/ttyUSB0?model=n150`,
with a free square of 2 m to its left).
"""

# %% tags=["parameters"]
ADDRESS = "sim:arena?setup=worn&seed=2&start=200,150,0,0"
SIDES = 4  # quick: 1
RUNS = 40  # quick: 4

# %%
import math

import matplotlib.pyplot as plt
import numpy as np

from localization.course import check
from localization.course.lab import record
from nclient import connect

# %% [markdown]
"""
## A square

Four sides of 40 in, with a turn of 90° to the left at each corner. `record` returns a row per state: `drive.encoders`
has x, y and heading, and `drive.truth` the true pose, which only a simulation can report (NaN for a real robot).
"""

# %%
drive = record(ADDRESS, [(8, 0, 5), (0, 30, 3)] * SIDES)
start, end = drive.encoders[0], drive.encoders[-1]
print(f"encoders: {math.dist(start[:2], end[:2]):.1f} in from the start; true: "
      f"{math.dist(drive.truth[0][:2], drive.truth[-1][:2]):.1f} in")

# %%
figure, axes = plt.subplots(figsize=(5, 5))
axes.plot(*drive.encoders[:, :2].T, ":", label="encoders")
axes.plot(*drive.truth[:, :2].T, "k-", label="truth")
axes.set(xlabel="x (in)", ylabel="y (in)", aspect="equal")
axes.legend()
plt.show()

# %% [markdown]
"""
## Task 1: a step

Write the formulas above. `pose` is `(x, y, heading)`; return the new pose. The check calls your function with random
numbers and explains what is wrong.
"""

# %% tags=["task"]
def step_pose(pose, distance_in, turn_rad):
    raise NotImplementedError


# %%
check(step_pose)

# %% [markdown]
r"""
## Task 2: the step between two poses

A filter needs steps, but robots report poses. Return the distance and the turn that lead from the pose `before` to
the pose `after`. Two things to mind:

- Headings are in $[0, 2\pi)$, so a small turn may look like one of almost $2\pi$. Bring it into $(-\pi, \pi]$.
- A robot that drives backwards has a negative distance. Project the displacement from `before` to `after` on the mean
  heading.
"""

# %% tags=["task"]
def relative_step(before, after):
    raise NotImplementedError


# %%
check(relative_step)

# %% [markdown]
"""
Both together give the path again. Encoders report tenths of an inch and of a degree, so we take every fifth state:
rounding errors of many tiny steps would add up.
"""

# %%
rows = drive.encoders[::5]
path = [tuple(rows[0])]
for before, after in zip(rows, rows[1:]):
    path.append(step_pose(path[-1], *relative_step(before, after)))
difference = np.abs(np.array(path)[:, :2] - rows[:, :2]).max()
print(f"largest difference from the encoders: {difference:.2f} in")

# %% [markdown]
r"""
## How large is the error?

Wheels slip a little, at random. After $d$ inches the sum of many small independent errors has a variance proportional
to $d$:

$$
\operatorname{var}(e) = \alpha\, d
$$

so the standard deviation grows with the root of the distance. Here are simulated robots that drive straight ahead,
each over another distance; `errors` is the true distance minus that of the encoders.
"""

# %%
distances, errors = [], []
for seed in range(RUNS):
    with connect(f"sim:arena?noisy=1&seed={seed}&start=200,150,0,0") as robot:
        robot.move(translation_in=20 + 60 * seed / RUNS)
        state, truth = robot.wait_until_still(timeout_s=20), robot.truth()
        counted = math.hypot(state.x_in - 200, state.y_in - 150)
        distances.append(counted)
        errors.append(math.hypot(truth.x_in - 200, truth.y_in - 150) - counted)
distances, errors = np.array(distances), np.array(errors)

# %% [markdown]
r"""
## Task 3: estimate $\alpha$

Given arrays of distances and errors, return an estimate of $\alpha$.
"""

# %% tags=["task"]
def random_error(distances_in, errors_in):
    raise NotImplementedError


# %%
check(random_error)

# %%
alpha = random_error(distances, errors)
print(f"alpha = {alpha:.4f} in: after 100 in the error is {math.sqrt(100 * alpha):.1f} in (standard deviation)")

figure, axes = plt.subplots(figsize=(7, 4))
axes.plot(distances, errors, ".")
along = np.linspace(0, distances.max())
for sign in (-1, 1):
    axes.plot(along, sign * 2 * np.sqrt(alpha * along), "--", color="0.4")
axes.set(xlabel="distance (in)", ylabel="error (in)", title="errors, and two standard deviations")
plt.show()

# %% [markdown]
r"""
The simulation has $\alpha = 0.01$ in. The estimate itself is random: its standard deviation is $\alpha \sqrt{2/n}$,
22 % of $\alpha$ for $n = 40$ runs. Turns have an error as well, and it matters more: a heading that is wrong by 0.05
rad puts the robot 5 in to the side after 100 in. The next notebooks use sonars against that.
"""
