"""Checks of notebooks 04 to 09: grids, Kalman filters, association, Monte Carlo localization, lost robots."""

from __future__ import annotations

from math import cos, pi, sin, sqrt
from statistics import NormalDist

import numpy as np
import numpy.typing as npt

from localization.course import tasks
from localization.course.tasks import TRIES, Answer, Part, Rng, Wrong, expect, expect_two, numbers, require, task
from worlds.raycast import cast_ray

Floats = npt.NDArray[np.float64]

MAX_RANGE_IN = 255.0
NEVER = -1
"""No reflector explains a reading."""


def _belief(rng: Rng, cells: int = 12) -> Floats:
    return rng.dirichlet(np.full(cells, 2.0))


@task("04", points=2)
def predict_grid(answer: Answer, rng: Rng) -> None:
    """Check a belief after a motion of a few cells."""
    for _ in range(TRIES):
        belief, kernel = _belief(rng), _belief(rng, int(rng.integers(2, 5)))
        cells, right, lost = len(belief), np.zeros(len(belief)), np.zeros(len(belief))
        wrapped, backwards = np.zeros(cells), np.zeros(cells)
        # All moves from all cells.
        for cell in range(cells):
            for steps, probability in enumerate(kernel):
                right[min(cell + steps, cells - 1)] += belief[cell] * probability
                wrapped[(cell + steps) % cells] += belief[cell] * probability
                backwards[max(cell - steps, 0)] += belief[cell] * probability
                if cell + steps < cells:
                    lost[cell + steps] += belief[cell] * probability
        mistakes = [
            (wrapped, "What leaves the corridor at its end does not come back at its beginning."),
            (lost, "What would leave the corridor stays in the last cell; here it is lost, and the sum is below 1."),
            (lost / lost.sum(),
             "What would leave the corridor stays in the last cell: do not spread it by normalizing."),
            (backwards, "kernel[k] is the probability of k cells forwards."),
        ]
        expect(answer, (belief, kernel), right, 1e-9, mistakes=mistakes,
               hint="Add belief[i] * kernel[k] to cell i + k for all i and k.")  # fmt: skip


@task("04")
def update_grid(answer: Answer, rng: Rng) -> None:
    """Check a belief after a reading."""
    for _ in range(TRIES):
        belief, likelihood = _belief(rng), rng.uniform(0, 0.02, 12)
        product = belief * likelihood
        mistakes = [
            (product, "Divide by the sum: probabilities sum to 1."),
            (likelihood / likelihood.sum(), "Multiply by the belief before the reading."),
            ((belief + likelihood) / (belief + likelihood).sum(), "Multiply; do not add."),
        ]
        expect(answer, (belief, likelihood), product / product.sum(), 1e-9, mistakes=mistakes)
    belief = _belief(rng)
    expect(answer, (belief, np.zeros(12)), belief, 1e-9, hint="If no cell explains a reading, return the belief.")


@task("04")
def reading_likelihood(answer: Answer, rng: Rng) -> None:
    """Check the density of a reading: a Gaussian, and a uniform part."""
    for _ in range(TRIES):
        expected, std = rng.uniform(20, 100, 5), float(rng.uniform(0.5, 4))
        reading, p_random = float(expected[0] + rng.uniform(-2, 2) * std), float(rng.uniform(0.05, 0.3))
        density = np.array([NormalDist(mean, std).pdf(reading) for mean in expected])
        bell = density * std * sqrt(2 * pi)
        mistakes = [
            (density, "A reading is random with the probability p_random: add p_random / 255."),
            (density + p_random / MAX_RANGE_IN, "The Gaussian part has the weight 1 - p_random."),
            ((1 - p_random) * density + p_random, "The uniform density over 255 in is 1 / 255."),
            ((1 - p_random) * bell + p_random / MAX_RANGE_IN,
             "The Gaussian density has the factor 1 / (std sqrt(2 pi))."),
            ((1 - p_random) * density, "Add the uniform part, p_random / 255."),
        ]
        right = (1 - p_random) * density + p_random / MAX_RANGE_IN
        expect(answer, (reading, expected, std, p_random), right, 1e-6, mistakes=mistakes)


@task("05")
def predict_line(answer: Answer, rng: Rng) -> None:
    """Check the distance to a wall, and its variance, after driving towards it."""
    for _ in range(TRIES):
        x, P, u, Q = rng.uniform((50, 0.2, 1, 0.05), (100, 4, 5, 0.5)).tolist()
        mistakes = [
            ((x + u, P + Q), "Driving towards the wall makes the distance smaller."),
            ((x - u, P), "Driving makes the estimate less certain: the variance grows by Q."),
            ((x - u, P - Q), "Driving makes the estimate less certain, not more."),
            ((x - u, (sqrt(P) + sqrt(Q)) ** 2), "Variances of independent errors add."),
        ]
        expect(answer, (x, P, u, Q), (x - u, P + Q), 1e-9, mistakes=mistakes, hint="Return x and P.")


@task("05", points=2)
def update_line(answer: Answer, rng: Rng) -> None:
    """Check estimate and variance after a reading, against Bayes' rule on a fine grid."""
    for _ in range(TRIES):
        x, P, R = rng.uniform((50, 0.5, 0.5), (100, 9, 9)).tolist()
        z = x + float(rng.normal(0, sqrt(P + R)))
        places = x + np.linspace(-12, 12, 6001) * sqrt(P)
        weights = np.exp(-0.5 * ((places - x) ** 2 / P + (places - z) ** 2 / R))
        weights /= weights.sum()
        mean = float(weights @ places)
        variance = float(weights @ (places - mean) ** 2)
        K, wrong = P / (P + R), R / (P + R)
        mistakes = [
            ((x + wrong * (z - x), (1 - wrong) * P),
             "The gain is P / (P + R): an uncertain estimate follows the reading."),
            ((mean, P), "A reading makes the variance smaller, too."),
            ((x - K * (z - x), variance), "The innovation is the reading minus the expected one."),
            ((mean, (1 + K) * P), "The variance becomes smaller: (1 - K) P."),
            (((x + z) / 2, variance), "The mean of both is right only if P equals R."),
        ]
        expect(answer, (x, P, z, R), (mean, variance), 1e-3 * (1 + P), mistakes=mistakes, hint="Return x and P.")


@task("05")
def is_consistent(answer: Answer, rng: Rng) -> None:
    """Check the test of a filter by its mean NIS."""
    for factor, right, about in (
        (1.0, True, "are as large as their variances say"),
        (2.5, False, "are 2.5 times too large"),
        (0.4, False, "are 2.5 times too small: the filter is too careful"),
        (1.0, True, "are as large as their variances say"),
    ):
        n = int(rng.integers(80, 200))
        variances = rng.uniform(0.5, 40, n)
        innovations = rng.standard_normal(n)
        # Exactly in the middle of the interval: no bound decides.
        innovations *= factor * np.sqrt(variances) / sqrt(np.mean(innovations**2))
        found = tasks.truth_value(answer, innovations, variances)
        require(found is right, f"{n} innovations {about}; it returned {found}. The mean of innovation^2 / S is 1 on "
                                "average, and its variance is 2 / n.")  # fmt: skip


@task("06", points=2)
def motion_jacobians(answer: Answer, rng: Rng) -> None:
    """Check F and G of the motion, against differences."""

    def move(pose: Floats, step: Floats) -> Floats:
        angle = pose[2] + step[1] / 2
        return np.array([pose[0] + step[0] * cos(angle), pose[1] + step[0] * sin(angle), pose[2] + step[1]])

    for _ in range(TRIES):
        heading, distance, turn = rng.uniform((0, 1, -0.3), (2 * pi, 5, 0.3)).tolist()
        pose, step, small = np.array([0.0, 0.0, heading]), np.array([distance, turn]), 1e-5
        F = np.stack([(move(pose + d, step) - move(pose - d, step)) / (2 * small) for d in small * np.eye(3)], axis=1)
        G = np.stack([(move(pose, step + d) - move(pose, step - d)) / (2 * small) for d in small * np.eye(2)], axis=1)
        no_half = G.copy()
        no_half[:2, 1] *= 2
        expect_two(
            answer, (heading, distance, turn), "Return two arrays: F (3 x 3) and G (3 x 2).",
            Part(F, 0.03 * distance, "F: derivatives of x', y', heading' by x, y, heading.", [
                (F.T, "F is transposed: a row for each coordinate of the new pose."),
                (F - np.eye(3), "x, y and heading also depend on themselves: 1 on the diagonal."),
                (2 * np.eye(3) - F, "The signs: the derivative of the cosine is minus the sine."),
            ]),
            Part(G, 0.02 * distance, "G: derivatives of x', y', heading' by distance and turn.", [
                (no_half, "The heading while driving is that at half of the turn: the chain rule gives a factor 1/2."),
            ]),
        )  # fmt: skip


@task("06", points=2)
def range_and_jacobian(answer: Answer, rng: Rng) -> None:
    """Check the range to a wall n . p = rho and its derivatives by the pose."""
    for _ in range(TRIES):
        x, y, heading, bearing = rng.uniform((-20, -20, 0, 0), (20, 20, 2 * pi, 2 * pi)).tolist()
        # The wall lies ahead of the beam, turned by up to 40 degrees.
        alpha = heading + bearing + rng.uniform(-0.7, 0.7)
        n = np.array([cos(alpha), sin(alpha)])
        rho = float(n @ (x, y) + rng.uniform(15, 60))
        along = np.array([-n[1], n[0]])
        wall = np.array([[*(rho * n - 1e4 * along), *(rho * n + 1e4 * along)]])

        def measure(pose: Floats, bearing: float = bearing, wall: Floats = wall) -> float:
            return cast_ray(pose[0], pose[1], cos(pose[2] + bearing), sin(pose[2] + bearing), wall)[0]

        pose, small = np.array([x, y, heading]), 1e-4
        h = measure(pose)
        H = np.array([(measure(pose + d) - measure(pose - d)) / (2 * small) for d in small * np.eye(3)])
        expect_two(
            answer, (pose, bearing, n, rho), "Return the range and the three derivatives.",
            Part(h, 1e-3, "range = (rho - n . p) / (n . u), with u the direction of the beam.", [
                (rho - n @ (x, y), "That is the distance to the wall; divide by n . u for the range along the beam."),
            ]),
            Part(H, 0.002 * (1 + abs(H[2])), "H: derivatives of the range by x, y and heading.", [
                (-H, "The signs: the range becomes shorter towards the wall."),
                ((*H[:2], 0.0), "The range also depends on the heading, which turns the beam."),
                ((*H[:2], -H[2]), "The derivative by the heading has the other sign."),
                ((-n[0], -n[1], H[2]), "Divide by n . u: along a slanted beam the range changes faster."),
            ]),
        )  # fmt: skip


@task("06", points=2)
def update_pose(answer: Answer, rng: Rng) -> None:
    """Check the Kalman update by one range, against the information form."""
    for _ in range(TRIES):
        root = rng.normal(0, 1, (3, 3)) * (1.0, 1.0, 0.1)
        P, x = root.T @ root + 1e-3 * np.eye(3), rng.uniform(-50, 50, 3)
        H, innovation, R = rng.normal(0, 1, 3) * (1, 1, 20), float(rng.normal(0, 2)), float(rng.uniform(0.1, 2))
        P_new = np.linalg.inv(np.linalg.inv(P) + np.outer(H, H) / R)
        x_new, S = x + P_new @ H * innovation / R, H @ P @ H + R
        K = P @ H / S
        expect_two(
            answer, (x, P, innovation, H, R), "Return x (3 numbers) and P (3 x 3).",
            Part(x_new, 1e-6, "x = x + K innovation, with K = P H' / S and S = H P H' + R.", [
                (x - K * innovation, "Add K times the innovation."),
                (x + P @ H / (H @ P @ H) * innovation, "S = H P H' + R: the noise of the reading is missing."),
                (x + P @ H * innovation, "The gain is P H' / S."),
            ]),
            Part(P_new, 1e-6 * (1 + np.abs(P)), "P = P - K H P. K H is a matrix: np.outer.", [
                (P, "A reading makes P smaller."),
                (P + np.outer(K, H @ P), "P becomes smaller: P - K H P."),
            ]),
        )  # fmt: skip


@task("07")
def mahalanobis2(answer: Answer, rng: Rng) -> None:
    """Check the squared Mahalanobis distance, against whitened coordinates."""
    for size in (1, 2, 2, 3, 3):
        root = np.tril(rng.normal(0, 1, (size, size))) + 2 * np.eye(size)
        S, innovation = root @ root.T, rng.normal(0, 3, size)
        white = np.zeros(size)
        for row in range(size):
            white[row] = (innovation[row] - root[row, :row] @ white[:row]) / root[row, row]
        right = float(white @ white)
        mistakes = [
            (sqrt(right), "Without the root: the square is what chi-square is about."),
            (innovation @ S @ innovation, "Divide by S: the inverse stands in the middle."),
            (innovation @ innovation, "That is the ordinary distance; S is missing."),
            (np.sum(innovation**2 / np.diag(S)), "S has elements beside its diagonal."),
        ]
        expect(answer, (innovation, S), right, 1e-6 * (1 + right), mistakes=mistakes)


@task("07", points=2)
def nearest_reflector(answer: Answer, rng: Rng) -> None:
    """Check which reflector explains a reading, -1 if none does."""
    for k in range(6 * TRIES):
        # Reflectors close together, readings near them, some standard deviations off, and far away.
        expected, variances, gate = rng.uniform(50, 70, 4), np.exp(rng.uniform(-2, 3, 4)), 9.0
        readings = rng.uniform(45, 75), 70 + rng.uniform(4, 10) * sqrt(variances.max()), rng.uniform(130, 250)
        reading = float(readings[k % 3])
        distances = (reading - expected) ** 2 / variances
        # Cases that rounding or a strict gate would decide are left out.
        if np.min(np.abs(distances - gate)) < 0.1 or np.diff(np.sort(distances))[0] < 0.1:
            continue
        right = int(distances.argmin()) if distances.min() < gate else NEVER
        found = float(numbers(answer, reading, expected, variances, gate, shape=()))
        hint = "Compare squared innovations divided by their variances with the gate."
        if found == int(np.abs(reading - expected).argmin()):
            hint = "The nearest in inches is not the nearest in standard deviations."
            if right == NEVER:
                hint = "Nothing is within the gate: return -1."
        elif found == NEVER:
            hint = "It is within the gate: the gate belongs to the squared distance."
        require(
            found == right,
            f"reading {reading:.1f}, expected {np.round(expected, 1).tolist()}, variances "
            f"{np.round(variances, 2).tolist()}, gate {gate:g}: it returned {found:g}, expected {right}. {hint}",
        )


@task("07", points=2)
def association_probabilities(answer: Answer, rng: Rng) -> None:
    """Check the probabilities of all explanations of a reading, the random one last."""
    for _ in range(TRIES):
        innovations, variances = rng.normal(0, 3, 3), rng.uniform(0.5, 16, 3)
        p_random = float(rng.uniform(0.05, 0.4))
        density = np.array([NormalDist(0, sqrt(v)).pdf(e) for e, v in zip(innovations, variances, strict=True)])
        weights = np.array([*((1 - p_random) / 3 * density), p_random / MAX_RANGE_IN])
        bell = np.array([*((1 - p_random) / 3 * np.exp(-0.5 * innovations**2 / variances)), p_random / MAX_RANGE_IN])
        several = np.array([*((1 - p_random) * density), p_random / MAX_RANGE_IN])
        flat = np.array([*((1 - p_random) / 3 * density), p_random])
        mistakes = [
            (weights, "Divide by the sum: one of the explanations is true."),
            (bell / bell.sum(), "The density has the factor 1 / sqrt(2 pi S): wide ones are lower."),
            (several / several.sum(), "Each of the m reflectors has the prior (1 - p_random) / m."),
            (flat / flat.sum(), "The density of a random reading is 1 / 255."),
        ]
        expect(answer, (innovations, variances, p_random), weights / weights.sum(), 1e-6, mistakes=mistakes)


VAR_PER_IN, VAR_PER_RAD, TURN_VAR_PER_IN = 0.01, 0.01, 0.000025
"""Noise of the setup `noisy`: distance per inch, turn per radian and per inch."""
SLOW, FAST = 0.05, 0.5
"""Rates of the averages of notebook 09."""
FOUND = 0.95


@task("08", points=2)
def move_particles(answer: Answer, rng: Rng) -> None:
    """Check the mean and the spread of particles after a step."""
    n = 20_000
    for _ in range(3):
        x, y, heading, distance, turn = rng.uniform((-20, -20, 0, 5, -1), (20, 20, 2 * pi, 10, 1)).tolist()
        particles = np.tile((x, y, heading), (n, 1))
        moved = numbers(answer, particles, distance, turn, rng, shape=(n, 3))
        std = np.array([sqrt(VAR_PER_IN * distance), sqrt(VAR_PER_RAD * abs(turn) + TURN_VAR_PER_IN * distance)])
        turned = (moved[:, 2] - heading - turn + pi) % (2 * pi) - pi
        require(moved.std(axis=0).max() > 0,
                "All particles move alike: draw noise for each of them, size=len(particles).")  # fmt: skip
        require(abs(turned.mean()) < 0.02,
                f"The headings change by {turn + turned.mean():.3f} rad on average, not by {turn:.3f}.")  # fmt: skip
        require(
            abs(turned.std() / std[1] - 1) < 0.05,
            f"The turns have the standard deviation {turned.std():.4f} rad; "
            f"expected {std[1]:.4f}. rng.normal takes a standard deviation, the root of the variance.",
        )
        # Along the mean direction lies the noise of the distance, across it that of the turn.
        angle = heading + turn / 2
        off = moved[:, :2] - (x, y)
        ahead, aside = off @ (cos(angle), sin(angle)), off @ (-sin(angle), cos(angle))
        require(
            abs(ahead.mean() - distance) < 0.05 * distance and abs(aside.mean()) < 0.05 * distance,
            f"The particles move by ({ahead.mean():.2f}, {aside.mean():.2f}) in along and across the mean direction on "
            f"average; expected ({distance:.2f}, 0). The heading while driving is that at half of the turn.",
        )
        require(abs(ahead.std() / std[0] - 1) < 0.1,
                f"The distances have the standard deviation {ahead.std():.3f} in; expected {std[0]:.3f}.")


@task("08", points=2)
def weigh_particles(answer: Answer, rng: Rng) -> None:
    """Check weights after readings, also where all densities are below the smallest number."""
    for k in range(TRIES):
        n, readings = 6, 3
        weights, std = rng.dirichlet(np.ones(n)), float(rng.uniform(0.5, 2))
        expected = (120 if k % 3 == 0 else 60) + rng.normal(0, std, (n, readings))
        measured = 60 + rng.normal(0, std, readings)
        logs = np.log(weights) - 0.5 * np.sum((measured - expected) ** 2, axis=1) / std**2
        right = np.exp(logs - logs.max())
        right /= right.sum()
        once = np.exp(logs - np.log(weights) - (logs - np.log(weights)).max())
        added = weights * np.exp(-0.5 * (measured - expected) ** 2 / std**2).sum(axis=1)
        mistakes = [
            (once / once.sum(), "Multiply by the weights before."),
            (added / max(added.sum(), 1e-300), "Independent readings: multiply their densities."),
            (weights, "The readings change the weights."),
        ]
        expect(answer, (weights, measured, expected, std), right, 1e-6, mistakes=mistakes,
               hint="Weights sum to 1. Far away, densities become 0: subtract the largest logarithm first.")


@task("08", points=2)
def resample(answer: Answer, rng: Rng) -> None:
    """Check that particles are drawn as often as their weights say."""
    n, rounds = 20, 200
    weights = rng.dirichlet(np.full(n, 0.5))
    weights[:3] = 0.0
    weights /= weights.sum()
    counts = np.zeros(n)
    for _ in range(rounds):
        chosen = numbers(answer, weights, rng, shape=(n,))
        if not (np.mod(chosen, 1) == 0).all() or chosen.min() < 0 or chosen.max() >= n:
            raise Wrong(f"It returned {chosen.tolist()}; expected {n} indices from 0 to {n - 1}.")
        counts += np.bincount(chosen.astype(int), minlength=n)
    require(not counts[:3].any(), "Particles with the weight 0 were drawn.")
    # The spread of independent draws; systematic resampling has less.
    limit = 5 * np.sqrt(weights * (1 - weights) / (n * rounds)) + 1e-9
    worst = int(np.argmax(np.abs(counts / (n * rounds) - weights) / limit))
    require(
        abs(counts[worst] / (n * rounds) - weights[worst]) <= limit[worst],
        f"A particle with the weight {weights[worst]:.4f} was {counts[worst] / (n * rounds):.4f} of the draws, in "
        f"{rounds} rounds of {n}. Draw {n} times with replacement, with the weights as probabilities.",
    )


@task("08")
def mean_pose(answer: Answer, rng: Rng) -> None:
    """Check the weighted mean of particles, whose headings lie on both sides of 0."""
    for k in range(TRIES):
        n, centre = 30, float(rng.uniform(0, 2 * pi)) if k % 2 else 0.0
        particles = np.column_stack(
            (rng.normal(10, 5, n), rng.normal(-20, 5, n), rng.normal(centre, 0.2, n) % (2 * pi))
        )
        weights = rng.dirichlet(np.full(n, 0.5))
        # Headings around the centre are numbers on a line.
        off = (particles[:, 2] - centre + pi) % (2 * pi) - pi
        right = np.array([*(weights @ particles[:, :2]), centre + weights @ off])
        mistakes = [
            (weights @ particles,
             "Headings on both sides of 0 have no arithmetic mean: use the mean of cosines and sines."),
            ((*particles[:, :2].mean(axis=0), right[2]), "Use the weights for the position."),
        ]
        expect(answer, (particles, weights), right, (1e-6, 1e-6, 0.02), angles=(2,), mistakes=mistakes,
               hint="Weighted means of x and y, and the direction of the weighted mean of (cos, sin).")  # fmt: skip


@task("09")
def effective_number(answer: Answer, rng: Rng) -> None:
    """Check the number of particles that matter."""
    for n in (1, 5, 50):
        expect(answer, (np.full(n, 1 / n),), n, 1e-6, hint="n equal weights count as n particles.")
    for _ in range(TRIES):
        weights = rng.dirichlet(np.full(30, 0.3))
        right = 1 / np.sum(weights**2)
        mistakes = [
            (np.sum(weights**2), "That is its inverse."),
            (1 / weights.max(), "That looks at the largest weight only: use all of them."),
            (30, "The weights matter, not only the number of particles."),
            (np.count_nonzero(weights > 1 / 30), "Do not count: sum the squares of the weights."),
        ]
        expect(answer, (weights,), right, 1e-6 * right, mistakes=mistakes)


@task("09", points=2)
def random_fraction(answer: Answer, rng: Rng) -> None:
    """Check two averages of the readings' likelihood, and the fraction of random particles from them."""
    slow = fast = 1.0
    for k in range(3 * TRIES):
        # A robot that is moved to another place in the middle: nothing fits any more, then it does again.
        likelihood = float(rng.uniform(0.5, 1.0) * (0.05 if k // TRIES == 1 else 1.0))
        next_slow, next_fast = SLOW * likelihood + (1 - SLOW) * slow, FAST * likelihood + (1 - FAST) * fast
        right = (next_slow, next_fast, max(0.0, 1 - next_fast / next_slow))
        mistakes = [
            ((*right[:2], 1 - next_fast / next_slow), "A fraction is not negative: max(0, ...)."),
            ((*right[:2], max(0.0, 1 - next_slow / next_fast)), "Random particles are added while fast is below slow."),
            ((*right[:2], max(0.0, 1 - fast / slow)), "Use the new averages for the fraction."),
            (((1 - SLOW) * likelihood + SLOW * slow, (1 - FAST) * likelihood + FAST * fast, right[2]),
             "The rate is the weight of the new value."),
        ]
        expect(answer, (slow, fast, likelihood), right, 1e-9, mistakes=mistakes,
               hint=f"average + rate (likelihood - average), with the rates {SLOW} and {FAST}; then 1 - fast / slow.")
        slow, fast = next_slow, next_fast


@task("09", points=2)
def is_found(answer: Answer, rng: Rng) -> None:
    """Check whether 95 % of the weight lie in one place."""
    n, within = 400, 12.0
    centre, other = rng.uniform(0, 40, 2), rng.uniform(60, 100, 2)

    def near(place: npt.NDArray[np.float64], count: int) -> npt.NDArray[np.float64]:
        return np.column_stack((rng.normal(place, 2.0, (count, 2)), rng.uniform(0, 6, count)))

    equal = np.full(n, 1 / n)
    light = np.r_[np.full(n // 2, 2 / n * 0.995), np.full(n // 2, 2 / n * 0.005)]
    stray = np.vstack((near(centre, n - 8), rng.uniform((-200, -200, 0), (200, 200, 6), (8, 3))))
    spread = np.column_stack((rng.uniform(0, 100, (n, 2)), rng.uniform(0, 6, n)))
    for particles, weights, right, about in (
        (near(centre, n), equal, True, "All particles are within 12 in of their mean."),
        (np.vstack((near(centre, n // 2), near(other, n // 2))), equal, False, "There are two groups of equal weight."),
        (spread, equal, False, "The particles fill the room."),
        (np.vstack((near(centre, n // 2), near(other, n // 2))), light, True,
         "Of two groups one has 0.5 % of the weight."),
        (stray, equal, True, "2 % of the particles are anywhere, the others in one place."),
        (np.vstack((near(centre, n * 7 // 10), near(other, n * 3 // 10))), equal, False, "30 % are in another place."),
    ):
        found = tasks.truth_value(answer, particles, weights, within)
        require(
            found is right,
            f"{about} It returned {found}; expected {right}. Sum the weights of the particles that are "
            "at most `within_in` inches from the weighted mean position.",
        )
