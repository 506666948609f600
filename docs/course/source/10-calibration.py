# %% [markdown]
r"""
# 10 Calibration

Random errors average out; *systematic* ones do not. A wheel that is 3 % larger than the software assumes makes every
counted distance some 3 % shorter than the true one, always in the same way. Such errors can be measured, and then
removed:

$$
\text{true distance} = s_d \cdot \text{counted}, \qquad
\text{true turn} = s_a \cdot \text{counted turn} + \beta \cdot \text{counted distance}
$$

with the distance scale $s_d$, the turn scale $s_a$ and the drift $\beta$ (Borenstein and Feng, *Measurement and
Correction of Systematic Odometry Errors in Mobile Robots*, 1996). The tool is least squares: of all parameters take
those that make the sum of squared residuals smallest.
"""

# %% tags=["parameters"]
ADDRESS = "sim:thesis_room?setup=out/course_robot.toml&seed=1&start=20,45,0,0"
DRIVES = 16  # quick: 3

# %%
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from localization.course import check
from localization.course.lab import RING_IN, expected_ranges, record
from worlds.io import load_world

# %% [markdown]
"""
This file describes the robot of this notebook. Its numbers are what you will estimate, so do not read them yet.
"""

# %%
Path("out").mkdir(exist_ok=True)
Path("out/course_robot.toml").write_text("""
base = "noisy"
[motion]
alpha1 = 0.001
alpha2 = 2.5e-6
alpha3 = 0.001
[odometry]
scales = [1.04, 0.97, 0.97]
drifts = [0.001, 0]
[sonar]
offsets_in = [1.5, 1.5, 1.5, 1.5, 1.5, 1.5, 1.5, 1.5, 1.5, 1.5, 1.5, 1.5, 1.5, 1.5, 1.5, 1.5]
""")

# %% [markdown]
"""
## Task 1: the distance scale

`counted_in` are distances by the encoders, `measured_in` those of a tape measure. Return the scale: true inches per
counted inch.
"""

# %% tags=["task"]
def fit_scale(counted_in, measured_in):
    raise NotImplementedError


# %%
check(fit_scale)

# %% [markdown]
"""
No tape at hand? A wall ahead will do: the robot drives towards it, and the range becomes smaller by the true
distance, while a constant error of the sonar cancels. It stands for 3 s first: the mean of many readings is a better
start than one. The random error of the wheels remains; it is some 0.2 in after 40 in (standard deviation), so one
drive gives the scale within half a per cent or so.
"""

# %%
drive = record(ADDRESS, [(0, 0, 3), (4, 0, 10)], sonars=[0])
counted = np.hypot(*(drive.encoders[:, :2] - drive.encoders[0, :2]).T)
measured = drive.sonars_in[:25, 0].mean() - drive.sonars_in[:, 0]
scale = fit_scale(counted, measured)
figure, axes = plt.subplots(figsize=(6, 4.5))
axes.plot(counted, measured, ".", markersize=3)
axes.plot(counted, scale * counted, label=f"scale {scale:.3f}")
axes.plot(counted, counted, "k:", label="1")
axes.set(xlabel="counted (in)", ylabel="decrease of the range (in)")
axes.legend()
plt.show()

# %% [markdown]
r"""
## Task 2: turn scale and drift

Each drive has a counted distance, a counted turn, and a true turn, measured for instance with a protractor on the
floor. There are two unknowns, so this is a linear least squares problem $A p = b$ with the columns turns and
distances in $A$ and $p = (s_a, \beta)$. Return both.
"""

# %% tags=["task"]
def fit_turn_and_drift(distances_in, turns_rad, true_turns_rad):
    raise NotImplementedError


# %%
check(fit_turn_and_drift)

# %% [markdown]
r"""
## Task 3: how certain is the result?

If the measured true turns have independent errors with the standard deviation $\sigma$, the covariance of the
parameters is $P = \sigma^2 (A^\top A)^{-1}$. Return the standard deviations of $s_a$ and $\beta$. They do not depend on
what was measured: a calibration can be planned.
"""

# %% tags=["task"]
def fit_std(distances_in, turns_rad, sigma_rad):
    raise NotImplementedError


# %%
check(fit_std)

# %% [markdown]
"""
Simulated drives along arcs, half of them to the left and half to the right, and their result:
"""

# %%
distances, turns, true_turns = [], [], []
for k in range(DRIVES):
    rate = (-1) ** k * (20 + 2 * k)
    arc = record(f"sim:arena?setup=out/course_robot.toml&seed={k}&start=260,200,0,0", [(8, rate, 6 + k / 2)])
    distances.append(np.hypot(*np.diff(arc.encoders[:, :2], axis=0).T).sum())
    turns.append(np.ptp(np.unwrap(arc.encoders[:, 2])) * np.sign(rate))
    true_turns.append(np.ptp(np.unwrap(arc.truth[:, 2])) * np.sign(rate))
distances, turns, true_turns = np.array(distances), np.array(turns), np.array(true_turns)

turn_scale, drift = fit_turn_and_drift(distances, turns, true_turns)
residuals = true_turns - turn_scale * turns - drift * distances
sigma = np.sqrt(np.sum(residuals**2) / (DRIVES - 2))
std = fit_std(distances, turns, sigma)
print(f"turn scale {turn_scale:.3f} ± {std[0]:.3f}, drift {1000 * drift:.2f} ± {1000 * std[1]:.2f} mrad/in")

# %%
figure, axes = plt.subplots(figsize=(6, 4.5))
axes.plot(turns, np.degrees(true_turns - turns), "o", label="before")
axes.plot(turns, np.degrees(residuals), "s", label="after the calibration")
axes.axhline(0, color="0.5", linewidth=1)
axes.set(xlabel="counted turn (rad)", ylabel="error of the turn (deg)")
axes.legend()
plt.show()

# %% [markdown]
"""
## Task 4: the offset of a sonar

Return the constant error of a sonar: reading minus range. Some readings are second echoes, twice as long, and some
are 255. The mean follows such *outliers*; the median does not.
"""

# %% tags=["task"]
def sonar_offset(readings_in, ranges_in):
    raise NotImplementedError


# %%
check(sonar_offset)

# %%
room = load_world("thesis_room")
poses = drive.truth if drive.has_truth else drive.encoders
offset = sonar_offset(drive.sonars_in[:, 0], expected_ranges(poses, [0], room)[:, 0])
print(f"sonar 0 reads {offset:.1f} in too much; the ring has a radius of {RING_IN} in")

# %% [markdown]
"""
Now read the file: the scales are 1.04 and 0.97, the drift 1 mrad/in, the offset 1.5 in. `nomad calibrate` finds
all of them, and the offsets of all sonars, in one drive without a tape ([Calibration](../calibration.md)).
"""
