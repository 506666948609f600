# %% [markdown]
r"""
# 5 A Kalman filter on a line

If a belief is a Gaussian, it has two numbers: a mean $x$ and a variance $P$. A Kalman filter predicts and updates
these two (Kalman 1960; Probabilistic Robotics, section 3.2). Here $x$ is the distance from a wall straight ahead:

| | mean | variance |
|---|---|---|
| predict: the encoders count $u$ inches towards the wall | $x \leftarrow x - u$ | $P \leftarrow P + Q$ |
| update: the sonar measures $z$ | $x \leftarrow x + K (z - x)$ | $P \leftarrow (1 - K) P$ |

with the gain $K = P / (P + R)$. $Q$ is the variance of the step's error, $R$ that of the reading.
"""

# %% tags=["parameters"]
ADDRESS = "sim:thesis_room?noisy=1&seed=4&start=0,45,0,0"
SECONDS = 20  # quick: 6

# %%
import math

import matplotlib.pyplot as plt
import numpy as np

from localization.course import check
from localization.course.lab import RING_IN, record

# %% [markdown]
"""
## Task 1: predict

The robot drives u inches towards the wall. Return the new x and P.
"""

# %% tags=["task"]
def predict_line(x, P, u, Q):
    raise NotImplementedError


# %%
check(predict_line)

# %% [markdown]
"""
## Task 2: update

Return x and P after a reading z. The check multiplies both Gaussians on a fine grid, as in the last notebook, and
compares.
"""

# %% tags=["task"]
def update_line(x, P, z, R):
    raise NotImplementedError


# %%
check(update_line)

# %% [markdown]
r"""
## Drive to the wall

Only sonar 0 fires. The filter begins 15 in wrong and knows that it is uncertain: $P = 15^2$. A simulated step of $d$
inches has the variance $Q = 0.01\, d$; a reading has the variance $R$ of notebook 2.
"""

# %%
drive = record(ADDRESS, [(3, 0, SECONDS)], sonars=[0])
readings = drive.sonars_in[:, 0] + RING_IN
steps = np.hypot(*np.diff(drive.encoders[:, :2], axis=0).T)
truth = 102.17 - drive.truth[:, 0]

x, P = readings[0] + 15, 15.0**2
estimates, innovations, variances = [(x, P)], [], []
for step, z in zip(steps, readings[1:]):
    x, P = predict_line(x, P, step, 0.01 * step)
    R = (0.01 * (z - RING_IN)) ** 2 + 1 / 12
    innovations.append(z - x)
    variances.append(P + R)
    x, P = update_line(x, P, z, R)
    estimates.append((x, P))
estimates, innovations, variances = np.array(estimates), np.array(innovations), np.array(variances)

# %%
band = 2 * np.sqrt(estimates[:, 1])
figure, (distance, error) = plt.subplots(2, 1, figsize=(9, 6), sharex=True)
distance.plot(drive.clock_s, readings, ".", markersize=3, label="readings")
distance.plot(drive.clock_s, estimates[:, 0], label="estimate")
distance.plot(drive.clock_s, truth, "k:", label="truth")
distance.set(ylabel="distance (in)")
distance.legend()
error.plot(drive.clock_s, estimates[:, 0] - truth)
error.fill_between(drive.clock_s, -band, band, alpha=0.2, label="two standard deviations")
error.set(xlabel="time (s)", ylabel="error (in)", ylim=(-2, 2))
error.legend()
plt.show()

# %% [markdown]
r"""
## Task 3: is the filter consistent?

The ground truth is a luxury. What a filter always has are its innovations $\nu = z - x$ and their variances $S = P +
R$. If both fit, the normalised innovation squared (NIS) $\nu^2 / S$ is 1 on average. The mean of $n$ of them has the
variance $2/n$, so 95 % of consistent filters have a mean within about $1 \pm 1.96 \sqrt{2/n}$ (Bar-Shalom, Li and
Kirubarajan, *Estimation with Applications to Tracking and Navigation*, 2001, section 5.4). A larger mean: the filter
is too sure of itself. A smaller one: it is too careful, and wastes readings.

Return True if the mean NIS is within this interval.
"""

# %% tags=["task"]
def is_consistent(innovations, variances):
    raise NotImplementedError


# %%
check(is_consistent)

# %%
later = slice(5, None)  # without the first steps, in which the wrong start fades
nis = innovations[later] ** 2 / variances[later]
print(f"mean NIS {nis.mean():.2f}; consistent: {is_consistent(innovations[later], variances[later])}")

# %% [markdown]
"""
Change Q or R by a factor of 4 and look at the mean NIS. Then drive more slowly, at 0.5 in/s: the same rounding error
now comes several times in a row. Readings of a robot that hardly moves are not independent, and no Kalman filter
knows that by itself.
"""
