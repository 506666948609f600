# %% [markdown]
r"""
# 6 An extended Kalman filter in a room

Now the state is a pose $(x, y, \theta)$, and neither motion nor measurement is linear. The *extended* Kalman filter
replaces both by their tangents at the estimate (Probabilistic Robotics, sections 3.3 and 7.4):

$$
\begin{aligned}
\text{predict:} \quad & P \leftarrow F P F^\top + G Q G^\top \\
\text{update:} \quad & S = H P H^\top + R, \quad K = P H^\top / S, \\
& x \leftarrow x + K \nu, \quad P \leftarrow P - K H P
\end{aligned}
$$

$F$ and $G$ are the derivatives of the new pose by the old one and by the step, $H$ that of the expected range by the
pose. $\nu$ is the innovation: the reading minus the expected range. This is the filter that `nomad localize` runs,
with more care about cones and outliers.
"""

# %% tags=["parameters"]
ADDRESS = "sim:thesis_room?noisy=1&seed=3"
WAYPOINTS = [(0, 0), (60, 40), (10, 70)]  # quick: [(0, 0), (25, 12)]

# %%
import math

import matplotlib.pyplot as plt
import numpy as np

from localization import plot
from localization.course import check
from localization.course.lab import run_filter
from worlds.io import load_world
from worlds.raycast import cast_ray

# %% [markdown]
r"""
## Task 1: the derivatives of the motion

The motion is that of notebook 1: $x' = x + d \cos(\theta + a/2)$, $y' = y + d \sin(\theta + a/2)$,
$\theta' = \theta + a$. Return two arrays: $F$ (3 x 3), derivatives by $x$, $y$, $\theta$, and $G$ (3 x 2), derivatives
by $d$ and $a$. The rows belong to $x'$, $y'$, $\theta'$.
"""

# %% tags=["task"]
def motion_jacobians(heading, distance, turn):
    raise NotImplementedError


# %%
check(motion_jacobians)

# %% [markdown]
r"""
## Task 2: the range and its derivatives

A wall is a line $n \cdot p = \rho$ with the unit normal $n$. From the position $p = (x, y)$ in the direction $u =
(\cos\varphi, \sin\varphi)$, $\varphi = \theta + \text{bearing}$, the range to it is

$$
h = \frac{\rho - n \cdot p}{n \cdot u}
$$

Return $h$ and its three derivatives by $x$, $y$, $\theta$. The last one contains $u' = (-\sin\varphi, \cos\varphi)$,
by the quotient rule.
"""

# %% tags=["task"]
def range_and_jacobian(pose, bearing, n, rho):
    raise NotImplementedError


# %%
check(range_and_jacobian)

# %% [markdown]
r"""
## Task 3: the update

Return x (3 numbers) and P (3 x 3) after one range with the innovation $\nu$, the derivatives $H$ (3 numbers) and the
variance $R$. $S$ is a number here, since ranges come one by one.
"""

# %% tags=["task"]
def update_pose(x, P, innovation, H, R):
    raise NotImplementedError


# %%
check(update_pose)

# %% [markdown]
"""
## Your filter drives a robot

The class below makes a filter of your functions, with the interface of [Your own filter](../own-filter.md). For each
echo it finds the wall on the axis of the sonar. Echoes more than three standard deviations off are not used: notebook
7 is about them.
"""

# %%
class RoomFilter:
    def __init__(self, config, belief):
        self.x, self.P, self.walls = belief.mean, belief.cov, np.asarray(config.walls)

    def predict(self, distance, turn):
        F, G = motion_jacobians(self.x[2], distance, turn)
        angle = self.x[2] + turn / 2
        self.x = self.x + np.array([distance * math.cos(angle), distance * math.sin(angle), turn])
        Q = np.diag([0.01 * abs(distance), 0.01 * abs(turn) + 0.000025 * abs(distance)])
        self.P = F @ self.P @ F.T + G @ Q @ G.T

    def update(self, echo):
        angle = self.x[2] + echo.direction_rad
        _, row = cast_ray(*self.x[:2], math.cos(angle), math.sin(angle), self.walls)
        if row < 0:
            return None
        x1, y1, x2, y2 = self.walls[row]
        n = np.array([y2 - y1, x1 - x2]) / math.hypot(x2 - x1, y2 - y1)
        h, H = range_and_jacobian(self.x, echo.direction_rad, n, n @ (x1, y1))
        H, innovation = np.asarray(H), echo.range_in + echo.ring_in - h
        R = 1 / 12 + (0.01 * (h - echo.ring_in)) ** 2
        S = H @ self.P @ H + R
        if innovation**2 > 9 * S:
            return None
        self.x, self.P = update_pose(self.x, self.P, innovation, H, R)
        return innovation, S


room = load_world("thesis_room")
run = run_filter(ADDRESS, RoomFilter, room, WAYPOINTS)
print(run.verdict())

# %%
plot.trajectory(run, room)

# %% [markdown]
"""
The dotted line is where the robot would think that it is without sonars. Now the errors, and the bands in which the
filter expects them (they need the ground truth):
"""

# %%
plot.errors(run)

# %%
plot.innovations(run)

# %% [markdown]
"""
About 95 % of the innovations should be within ±2. Set R to a quarter of its value: which picture shows the mistake
first?
"""
