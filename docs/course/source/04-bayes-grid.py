# %% [markdown]
r"""
# 4 Bayes on a grid

Where in a corridor is the robot? A *belief* is a probability for each place. It changes in two steps (Probabilistic
Robotics, section 8.2, Markov localization on a grid):

- **Prediction.** The robot moves. Where it is afterwards follows from where it was and from how well it moves: $\bar
  b(x) = \sum_{x'} p(x \mid u, x')\, b(x')$.
- **Update.** A sensor measures $z$. Bayes' rule: $b(x) = \eta\, p(z \mid x)\, \bar b(x)$, where $\eta$ makes the sum
  1.

The corridor is 40 m long and has ten doors on each side, all alike: 6 in deep, 13 ft apart. The robot does not know
where it starts.
"""

# %% tags=["parameters"]
ADDRESS = "sim:corridor?noisy=1&seed=1&start=1000,39.4,0,0"
SECONDS = 28  # quick: 6

# %%
import matplotlib.pyplot as plt
import numpy as np

from localization.course import check
from localization.course.lab import draw_map, expected_ranges, record
from worlds.io import load_world

CELL_IN = 4

# %% [markdown]
"""
## Task 1: predict

`belief[i]` is the probability of cell i, `kernel[k]` that of moving by k cells forwards. Return the belief after the
motion, as many cells as before. What would leave the grid stays in its last cell.
"""

# %% tags=["task"]
def predict_grid(belief, kernel):
    raise NotImplementedError


# %%
check(predict_grid)

# %% [markdown]
"""
## Task 2: update

`likelihood[i]` is the density of the reading if the robot is in cell i. Return the belief after the reading. If no
cell explains it, all likelihoods are 0: then return the belief unchanged.
"""

# %% tags=["task"]
def update_grid(belief, likelihood):
    raise NotImplementedError


# %%
check(update_grid)

# %% [markdown]
r"""
## Task 3: the likelihood of a reading

`expected_in` is an array: the range that an exact sonar would measure in each cell. A reading is either that plus
Gaussian noise, or, with the probability `p_random`, anything from 0 to 255 in with equal density:

$$
p(z \mid x) = (1 - p)\, \frac{1}{\sigma \sqrt{2\pi}}\, \exp\left(-\frac{(z - h(x))^2}{2 \sigma^2}\right) + \frac{p}{255}
$$

Without the second part one odd reading would rule out the true place for ever.
"""

# %% tags=["task"]
def reading_likelihood(reading_in, expected_in, std_in, p_random):
    raise NotImplementedError


# %%
check(reading_likelihood)

# %% [markdown]
"""
## Drive

The robot drives along the corridor and keeps to its middle by the sonars 2 and 14, which look 45° to both sides. Four
sonars fire in turn, one every 60 ms, so that each reading is at most a quarter of a second old.
"""

# %%
def keep_to_the_middle(state):
    turn = 0.4 * (state.sonars_in[2] - state.sonars_in[14])
    return 16, max(-8, min(8, turn))


drive = record(ADDRESS, keep_to_the_middle, SECONDS, sonars=[0, 12, 2, 14])
travelled = np.hypot(*np.diff(drive.encoders[:, :2], axis=0).T).cumsum()
print(f"{travelled[-1]:.0f} in by the encoders")

# %% [markdown]
"""
## Localize

Each time that the robot has moved by two cells: predict by one to three cells, update by the sonars 12 (to the right:
doors) and 0 (ahead: the end of the corridor, once it is near enough).
"""

# %%
corridor = load_world("corridor")
cells = np.arange(10, 1570, CELL_IN)
places = np.column_stack((cells, np.full(len(cells), 39.4), np.zeros(len(cells))))
expected = {number: expected_ranges(places, [number * np.pi / 8], corridor)[:, 0] for number in (0, 12)}

belief = np.full(len(cells), 1 / len(cells))
beliefs, rows, driven = [belief], [0], 0.0
for row in range(1, len(travelled)):
    if travelled[row] - driven < 2 * CELL_IN:
        continue
    driven += 2 * CELL_IN
    belief = predict_grid(belief, np.array([0, 0.1, 0.8, 0.1]))
    for number in (12, 0):
        belief = update_grid(belief, reading_likelihood(drive.sonars_in[row, number], expected[number], 2, 0.1))
    beliefs.append(belief)
    rows.append(row)

# %%
figure, (plan, history) = plt.subplots(2, 1, figsize=(10, 6), height_ratios=(1, 3), sharex=True)
draw_map(plan, corridor)
plan.set(aspect="auto", xlabel="")
history.imshow(np.sqrt(beliefs), aspect="auto", origin="lower", cmap="Greys",
               extent=(cells[0], cells[-1], 0, drive.clock_s[rows[-1]]))
history.plot(drive.truth[rows, 0], drive.clock_s[rows], "r:", label="truth")
history.set(xlabel="x (in)", ylabel="time (s)")
history.legend()
plt.show()
print(f"at the end x = {cells[np.argmax(belief)]} in with {belief.max():.0%}; true: {drive.truth[rows[-1], 0]:.0f} in")

# %% [markdown]
"""
The first door leaves ten places. All doors are alike, so only the end of the corridor decides; places that would be
beyond it drop out. A belief of several peaks is something that a Kalman filter, which the next notebook is about,
cannot represent.
"""
