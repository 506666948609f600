"""Time of a ray among 50 walls: the batch simulation, VMAS and Kheperax in the same run, by turns.

    python benchmarks/batch_rays.py [--robots N] [--rounds N] [--threads N] [--json]

Each robot stands between the 50 walls of the benchmark's room and casts sixteen rays. Of the batch that is the reading
of sixteen sonars that have fired, rounded to their resolution. Of the packages vmas and kheperax (torch and jax of the
CPU are enough) one that is not installed is left out.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, Final

import numpy as np
from batch import best, starts
from scenes import FREE_IN, HALF_IN, WALLS, room

from nserver_emu.simulation.batch import BatchSimulation
from nserver_emu.simulation.models import N150
from worlds.geometry import FloatArray

MAX_IN: Final = 255.0
"""Range of the sonars."""
RAYS: Final = 16

Cast = Callable[[], FloatArray]
"""Cast all rays; return the ranges (n, 16) from the centre of each robot, at most MAX_IN."""


def batch_rays(places: FloatArray, walls: FloatArray, threads: int | None) -> Cast:
    """Return the rays of the batch simulation."""
    world = room(HALF_IN, WALLS, np.zeros((1, 2)), FREE_IN)
    assert np.array_equal(world.walls, walls)
    batch = BatchSimulation(world, len(places), starts=places, threads=threads)

    def cast() -> FloatArray:
        # Marks all sonars as fired and unread: the next access casts all rays again.
        batch._robots["is_pending"], batch._is_observed = 1, False
        return np.minimum(batch.ranges_in + N150.body.ring.radius_in, MAX_IN)

    return cast


def vmas_rays(places: FloatArray, walls: FloatArray, threads: int | None) -> Cast:
    """Return the rays of VMAS' lidar, which casts all rays of all worlds at once. Raises ImportError."""
    import torch
    from vmas.simulator.core import Agent, Landmark, Line, World
    from vmas.simulator.sensors import Lidar

    # As many threads as the batch has.
    if threads:
        torch.set_num_threads(threads)
    world = World(len(places), "cpu")
    lidar = partial(Lidar, n_rays=RAYS, max_range=MAX_IN, entity_filter=lambda entity: isinstance(entity, Landmark))
    robot = Agent("robot", sensors=[lidar(world)])
    world.add_agent(robot)
    # Each wall is a landmark of its own in all worlds.
    for number, (x1, y1, x2, y2) in enumerate(walls.tolist()):
        wall = Landmark(f"wall {number}", shape=Line(float(np.hypot(x2 - x1, y2 - y1))), collide=True)
        world.add_landmark(wall)
        wall.set_pos(torch.tensor([0.5 * (x1 + x2), 0.5 * (y1 + y2)]), None)
        wall.set_rot(torch.tensor([np.arctan2(y2 - y1, x2 - x1)], dtype=torch.float32), None)
    robot.set_pos(torch.tensor(places[:, :2], dtype=torch.float32), None)
    robot.set_rot(torch.tensor(places[:, 3:], dtype=torch.float32), None)

    def cast() -> FloatArray:
        return np.asarray(robot.sensors[0].measure(), dtype=np.float64)

    return cast


def kheperax_rays(places: FloatArray, walls: FloatArray, _: int | None) -> Cast:
    """Return the rays of Kheperax' lasers, compiled for all robots at once. Raises ImportError."""
    import jax
    import jax.numpy as jnp
    from kheperax.simu.geoms import Pos, Segment
    from kheperax.simu.laser import Laser

    x1, y1, x2, y2 = (jnp.asarray(column, dtype=jnp.float32) for column in walls.T)
    # Noise 0: the key of the random numbers is unused.
    segments, key = Segment(Pos(x1, y1), Pos(x2, y2)), jax.random.PRNGKey(0)

    def ray(x: Any, y: Any, angle_rad: Any) -> Any:
        return Laser(Pos(x, y), angle_rad, MAX_IN).get_measure(segments, False, 0.0, key)

    # vmap over robots and then over the angles of each, compiled as one function.
    rings = jax.jit(jax.vmap(jax.vmap(ray, (None, None, 0))))
    angles_rad = places[:, 3:] + np.array(N150.body.ring.angles_rad)
    arguments = [jnp.asarray(values, dtype=jnp.float32) for values in (places[:, 0], places[:, 1], angles_rad)]

    # Copying to the processor waits for the result, which jax computes asynchronously.
    def cast() -> FloatArray:
        return np.asarray(rings(*arguments), dtype=np.float64)

    return cast


PEERS: Final[dict[str, Callable[[FloatArray, FloatArray, int | None], Cast]]] = {
    "vmas": vmas_rays,
    "kheperax": kheperax_rays,
}


def measure(robots: int, rounds: int, threads: int | None) -> dict[str, dict[str, float]]:
    """Return nanoseconds per ray by the clock and of the processor, and the median difference from the batch."""
    world = room(HALF_IN, WALLS, np.zeros((1, 2)), FREE_IN)
    places, walls = starts(robots, world), np.ascontiguousarray(world.walls)
    casts = {"batch": batch_rays(places, walls, threads)}
    for name, make in PEERS.items():
        try:
            casts[name] = make(places, walls, threads)
        except ImportError as error:
            print(f"{name} is left out: {error}; install the package {name}", file=sys.stderr)
    # The first calls compile.
    ranges = {name: cast() for name, cast in casts.items()}
    times = best(list(casts.values()), rounds)
    found = {}
    # The median difference shows that all cast the same rays; single ones may differ at the ends of walls.
    for (name, cast_ranges), (wall_s, cpu_s) in zip(ranges.items(), times, strict=True):
        per_ray = 1e9 / cast_ranges.size
        found[name] = {
            "ns_per_ray": round(wall_s * per_ray, 1),
            "cpu_ns_per_ray": round(cpu_s * per_ray, 1),
            "median_difference_in": round(float(np.median(np.abs(cast_ranges - ranges["batch"]))), 3),
        }
    return found


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robots", type=int, default=2000, help="robots, sixteen rays each (default: 2000)")
    parser.add_argument("--rounds", type=int, default=5, help="rounds, of which the best counts (default: 5)")
    parser.add_argument("--threads", type=int, help="threads of each (default: one per core)")
    parser.add_argument("--json", action="store_true", help="print JSON")
    options = parser.parse_args(arguments)
    found: dict[str, Any] = measure(options.robots, options.rounds, options.threads)
    if options.json:
        print(json.dumps(found))
        return 0
    for name, result in found.items():
        print(f"{name}: " + ", ".join(f"{key} {value}" for key, value in result.items()))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
