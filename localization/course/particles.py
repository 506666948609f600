"""Checks of notebooks 08 and 09: Monte Carlo localization, lost robots."""

from math import cos, pi, sin, sqrt

import numpy as np
import numpy.typing as npt

from localization.course.tasks import TRIES, Answer, Rng, Wrong, expect, numbers, require, task, truth_value

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
        require(
            moved.std(axis=0).max() > 0, "All particles move alike: draw noise for each of them, size=len(particles)."
        )
        require(
            abs(turned.mean()) < 0.02,
            f"The headings change by {turn + turned.mean():.3f} rad on average, not by {turn:.3f}.",
        )
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
        require(
            abs(ahead.std() / std[0] - 1) < 0.1,
            f"The distances have the standard deviation {ahead.std():.3f} in; expected {std[0]:.3f}.",
        )


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
        expect(
            answer,
            (weights, measured, expected, std),
            right,
            1e-6,
            mistakes=mistakes,
            hint="Weights sum to 1. Far away, densities become 0: subtract the largest logarithm first.",
        )


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
            (
                weights @ particles,
                "Headings on both sides of 0 have no arithmetic mean: use the mean of cosines and sines.",
            ),
            ((*particles[:, :2].mean(axis=0), right[2]), "Use the weights for the position."),
        ]
        expect(
            answer,
            (particles, weights),
            right,
            (1e-6, 1e-6, 0.02),
            angles=(2,),
            mistakes=mistakes,
            hint="Weighted means of x and y, and the direction of the weighted mean of (cos, sin).",
        )


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
            (
                ((1 - SLOW) * likelihood + SLOW * slow, (1 - FAST) * likelihood + FAST * fast, right[2]),
                "The rate is the weight of the new value.",
            ),
        ]
        expect(
            answer,
            (slow, fast, likelihood),
            right,
            1e-9,
            mistakes=mistakes,
            hint=f"average + rate (likelihood - average), with the rates {SLOW} and {FAST}; then 1 - fast / slow.",
        )
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
        (
            np.vstack((near(centre, n // 2), near(other, n // 2))),
            light,
            True,
            "Of two groups one has 0.5 % of the weight.",
        ),
        (stray, equal, True, "2 % of the particles are anywhere, the others in one place."),
        (np.vstack((near(centre, n * 7 // 10), near(other, n * 3 // 10))), equal, False, "30 % are in another place."),
    ):
        found = truth_value(answer, particles, weights, within)
        require(
            found is right,
            f"{about} It returned {found}; expected {right}. Sum the weights of the particles that are "
            "at most `within_in` inches from the weighted mean position.",
        )
