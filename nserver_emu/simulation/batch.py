"""Thousands of independent robots, stepped together by compiled code on all cores (extra `fast`).

    batch = BatchSimulation(load_world("thesis_room"), robots=10_000, setup=NOISY, seed=1)
    batch.set_velocities(10.0, 0.2, 0.0)
    batch.step(0.1)
    batch.ranges_in, batch.actual, batch.bumpers        arrays with one row per robot

Row i is the robot of number i + 1 of a `Simulation` with the same seed, alone in its world: the same readings, to the
bit without noise and to 1e-9 with it. The motion is that of `SimulatedRobot`, the formulas are the same functions
(batch_kernel.py). Robots do not see each other, and sonars are exact rays.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise, starmap, takewhile
from math import tau
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import numpy.typing as npt

from nclient.errors import ExtraMissing, StartError, install_hint
from nserver_emu.simulation.drive import NO_TRACK
from nserver_emu.simulation.models import N150, RobotModel
from nserver_emu.simulation.noise import IDEAL, Purpose, RngFactory, RobotSetup, apply_model
from nserver_emu.simulation.odometry import NO_NOISE
from nserver_emu.simulation.segments import PS_PER_S, to_ps
from nserver_emu.simulation.sonar import MAX_RATE, TICK_PS, SonarNoise
from worlds.geometry import FloatArray
from worlds.world import World

if TYPE_CHECKING:
    from nserver_emu.simulation import batch_kernel

MAX_STEP_S: Final = 3600.0
"""Longest step: within it, differences of times in picoseconds are exact in floating point."""

MAX_TIME_S: Final = 9.0e6
"""Longest simulated time, 104 days: a time in picoseconds must fit into 64 bits."""

Mask = npt.ArrayLike | None
"""True for the robots that are meant (n,); None: all."""


class BatchSimulation:
    """Robots of one model and setup, each alone in its world.

    Quantities are inches, radians and seconds, as in `SimulatedRobot`; arrays have one row per robot and are copies.

    Parameters
    ----------
    worlds
        A world for all robots, or one for each.
    robots
        Number of robots; None: as many as there are worlds.
    starts
        (n, 4) true x, y, steering and turret angle, or (4,) for all; None: the first start of each world.
    model, setup
        Of all robots. The model must not have infrared sensors, and the sonars of the setup must be exact rays.
    seed
        Seed of the run; robot i draws from the streams of robot number i + 1.
    threads
        Threads that share the robots; None: one per core.

    Attributes
    ----------
    model, setup, seed, threads
        As given; the setup with the calibration of the model.

    Raises
    ------
    ExtraMissing
        If numba is not installed.
    ValueError
        If model, setup or a number does not suit a batch.
    StartError
        If a robot does not fit at its start.
    """

    def __init__(self, worlds: World | Sequence[World], robots: int | None = None, *,
                 starts: npt.ArrayLike | None = None, model: RobotModel = N150, setup: RobotSetup = IDEAL,
                 seed: int = 0, threads: int | None = None) -> None:
        # 1. What a batch can simulate.
        self.model, self.setup, self.seed = model, apply_model(model, setup), seed
        _check(model, self.setup)
        self._worlds = _worlds(worlds, robots)
        if any(world.walkers for world in self._worlds):
            raise ValueError("expected worlds without walkers: each robot is alone; use Simulation for people who walk")
        kernel = self._kernel = _load_kernel()
        self._loops = kernel.load_loops()
        self.threads = max(1, threads or _cores())
        self._pool = ThreadPoolExecutor(self.threads) if self.threads > 1 else None
        # 2. Model, setup and walls. Worlds that are one object share their walls.
        self._settings = _settings(kernel, model, self.setup)
        self._timeout_ps = 0
        count = len(self._worlds)
        self._robots = np.zeros(count, kernel.robot_dtype(model.body.ring.count))
        rows = {id(world): world.walls for world in self._worlds}
        self._walls = np.ascontiguousarray(np.concatenate(list(rows.values())).T, dtype=np.float64)
        ends = dict(zip(rows, np.cumsum([len(walls) for walls in rows.values()]).tolist(), strict=True))
        self._robots["wall_end"] = [ends[id(world)] for world in self._worlds]
        self._robots["wall_begin"] = [ends[id(world)] - len(world.walls) for world in self._worlds]
        # 3. The robots at their starts.
        self._starts = np.array([(pose.x_in, pose.y_in, pose.steering_rad, pose.turret_rad)
                                 for pose in (w.starts[0] for w in self._worlds)])
        self._is_observed = False
        self.reset(starts=starts, seed=seed)

    def __len__(self) -> int:
        return len(self._robots)

    def reset(self, mask: Mask = None, *, starts: npt.ArrayLike | None = None, seed: int | None = None) -> None:
        """Begin anew with the robots of the mask: time 0, at rest, all sensors just switched on.

        Parameters
        ----------
        starts
            (n, 4) or (4,) as for the constructor, of which the rows of the mask count; None: the previous ones.
        seed
            Restart their random streams with this seed; None: continue them, so that each run draws other numbers.

        Raises
        ------
        StartError
            If a robot does not fit at its start.
        """
        chosen = self._mask(mask)
        # 1. Starts must be free.
        if starts is not None:
            given = np.broadcast_to(np.asarray(starts, dtype=np.float64), self._starts.shape)
            self._require_free(np.flatnonzero(chosen), given[:, :2])
            self._starts[chosen] = given[chosen]
        # 2. Everything but walls and streams at 0; the clearance of 0 makes the first motion search the walls.
        robots = self._robots
        for name in robots.dtype.names or ():
            if name not in ("wall_begin", "wall_end", "streams"):
                robots[name][chosen] = 0
        robots["pose"][chosen, :2] = robots["encoders"][chosen] = self._starts[chosen, :2]
        robots["angles"][chosen] = self._starts[chosen, 2:]
        if self._settings["track_in"][0] != NO_TRACK:
            # Steering and turret of a differential drive are one angle.
            robots["angles"][chosen, 1] = self._starts[chosen, 2]
        # 3. Random streams, then power.
        if seed is not None:
            words = self._kernel.stream_words
            for row in np.flatnonzero(chosen).tolist():
                factory = RngFactory(row + 1, seed)
                robots["streams"][row] = [words(factory, Purpose.MOTION), words(factory, Purpose.SONAR)]
        robots["deadline_ps"][chosen] = self._timeout_ps or self._kernel.NEVER_PS
        self._start_rings(chosen, True)

    def _require_free(self, rows: npt.NDArray[np.intp], places: FloatArray) -> None:
        """Raise StartError unless the robots of these rows fit at their places (n, 2)."""
        # All robots of a world at once; the first that does not fit asks for the reason.
        worlds = np.array([id(self._worlds[row]) for row in rows])
        for world in dict.fromkeys(worlds.tolist()):
            own = rows[worlds == world]
            is_free = self._worlds[own[0]].clearances(places[own]) > self.model.body.radius_in
            for row in own[~is_free].tolist():
                try:
                    self._worlds[row].require_free(*places[row].tolist(), self.model.body.radius_in)
                except StartError as error:
                    raise StartError(f"robot {row} of the batch: {error}") from None

    # Time

    def step(self, dt_s: float) -> None:
        """Advance all robots by dt_s seconds.

        Raises
        ------
        ValueError
            If dt_s is negative, above MAX_STEP_S, or would lead beyond MAX_TIME_S.
        """
        dt_ps = to_ps(dt_s)
        if dt_s > MAX_STEP_S:
            raise ValueError(f"expected a step of at most {MAX_STEP_S:g} s, got {dt_s} s; take several steps")
        if self._robots["time_ps"].max() + dt_ps > MAX_TIME_S * PS_PER_S:
            raise ValueError(f"simulated time ends at {MAX_TIME_S:g} s; reset the robots before")
        self._run(lambda part: self._loops.advance(self._robots[part], self._settings, self._walls, dt_ps))

    def _run(self, work: Callable[[slice], Any]) -> None:
        """Call a function for parts of the batch, in parallel."""
        self._is_observed = False
        bounds = np.linspace(0, len(self), self.threads + 1).astype(int).tolist()
        parts = list(starmap(slice, pairwise(bounds)))
        if self._pool is None:
            for part in parts:
                work(part)
        else:
            # The list raises what a thread has raised.
            list(self._pool.map(work, parts))

    # Commands

    def set_velocities(self, first: npt.ArrayLike, second: npt.ArrayLike, third: npt.ArrayLike,
                       mask: Mask = None) -> None:
        """Run at these velocities (n,) or numbers, as `SimulatedRobot.set_velocities`. C: vm."""
        self._command(first, second, third, mask, False)

    def move_relative(self, first: npt.ArrayLike, second: npt.ArrayLike, third: npt.ArrayLike,
                      mask: Mask = None) -> None:
        """Move by these distances (n,) or numbers, as `SimulatedRobot.move_relative`. C: pr."""
        self._command(first, second, third, mask, True)

    def stop(self, mask: Mask = None) -> None:
        """Brake and hold. C: st."""
        self.set_velocities(0.0, 0.0, 0.0, mask)

    def _command(self, first: npt.ArrayLike, second: npt.ArrayLike, third: npt.ArrayLike, mask: Mask,
                 is_relative: bool) -> None:
        values = np.empty((len(self), 3))
        for column, value in enumerate((first, second, third)):
            values[:, column] = value
        if not np.isfinite(values).all():
            raise ValueError("expected finite velocities and distances")
        chosen = self._mask(mask)
        self._loops.command(self._robots, self._settings, chosen, values, is_relative, self._timeout_ps)

    def set_timeout(self, seconds: float) -> None:
        """Stop every robot after so long without a command; 0 or less: never. C: conf_tm."""
        before_ps, self._timeout_ps = self._timeout_ps, to_ps(max(seconds, 0.0))
        time_ps, deadline_ps, never_ps = self._robots["time_ps"], self._robots["deadline_ps"], self._kernel.NEVER_PS
        from_now = time_ps + self._timeout_ps if self._timeout_ps else np.full(len(self), never_ps)
        if before_ps and self._timeout_ps:
            # It counts from the last command, which need not be this one.
            from_then = np.maximum(deadline_ps - before_ps + self._timeout_ps, time_ps)
            from_now = np.where(deadline_ps < never_ps, from_then, from_now)
        self._robots["deadline_ps"] = from_now

    def configure_sonars(self, rate: int, order: Sequence[int]) -> None:
        """Restart all rings at rate x 4 ms per sonar, one at a time; the first fires now. C: conf_sn."""
        firing = [(number,) for number in takewhile(range(self.model.body.ring.count).__contains__, order)]
        _set_order(self._settings, firing, min(max(rate, 1), MAX_RATE) * TICK_PS)
        self._start_rings(self._mask(None), False)

    def _start_rings(self, chosen: npt.NDArray[np.bool_], with_all: bool) -> None:
        self._is_observed = False
        self._loops.start_rings(self._robots, self._settings, chosen, with_all)

    def _mask(self, mask: Mask) -> npt.NDArray[np.bool_]:
        if mask is None:
            return np.ones(len(self), dtype=np.bool_)
        chosen = np.ascontiguousarray(mask)
        if chosen.shape != (len(self),) or chosen.dtype != np.bool_:
            raise ValueError(f"expected a mask of {len(self)} truth values, got {chosen.dtype} {chosen.shape}")
        return chosen

    # State

    @property
    def time_s(self) -> FloatArray:
        """Simulated time of each robot since it was reset (n,)."""
        return self._robots["time_ps"] / PS_PER_S

    @property
    def actual(self) -> FloatArray:
        """True poses (n, 4): x, y, steering and turret angle in [0, 2 pi)."""
        pose, angles = self._robots["pose"], self._robots["angles"]
        turret = angles[:, 1] + pose[:, 3] + pose[:, 2]
        return np.column_stack((pose[:, :2], _wrapped(angles[:, 0] + pose[:, 2]), _wrapped(turret)))

    @property
    def encoder(self) -> FloatArray:
        """Poses by the encoders (n, 4), columns as of `actual`."""
        return np.column_stack((self._robots["encoders"], _wrapped(self._robots["angles"])))

    @property
    def ranges_in(self) -> FloatArray:
        """The last reading of each sonar (n, s), inches from the ring; 0 where dead."""
        self._observe()
        return self._robots["readings_in"].copy()

    @property
    def bumpers(self) -> npt.NDArray[np.int64]:
        """Pressed bumpers as bits (n,): bit i is set while bumper i touches something."""
        self._observe()
        return self._robots["bumpers"].copy()

    @property
    def moving(self) -> npt.NDArray[np.bool_]:
        """True for each axis that moves (n, 3)."""
        spans = self._robots["spans"]
        return spans[:, :, 0] < spans[:, :, 1]

    @property
    def timed_out(self) -> npt.NDArray[np.bool_]:
        """True for each robot that the time-out has stopped since its last command (n,)."""
        return self._robots["has_timed_out"].copy()

    @property
    def bytes_per_robot(self) -> float:
        """Memory of the batch per robot, walls included."""
        return (self._robots.nbytes + self._walls.nbytes + self._starts.nbytes) / len(self)

    def _observe(self) -> None:
        """Compute the readings since the last call; unused rings cost nothing."""
        if not self._is_observed:
            self._run(lambda part: self._loops.observe(self._robots[part], self._settings, self._walls))
            self._is_observed = True


def _wrapped(angles_rad: FloatArray) -> FloatArray:
    """Return `wrap_to_2pi` of all angles."""
    wrapped = angles_rad % tau
    return np.where(wrapped < tau, wrapped, 0.0)


def _cores() -> int:
    """Return the cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _load_kernel() -> Any:
    """Return the module of compiled code. Raises ExtraMissing without numba."""
    try:
        from nserver_emu.simulation import batch_kernel
    except ImportError as error:
        hint = install_hint("numba")
        raise ExtraMissing(f"the batch simulation needs numba, which is not installed: {hint}") from error
    return batch_kernel


def _check(model: RobotModel, setup: RobotSetup) -> None:
    """Raise ValueError for a model or setup that a batch cannot simulate."""
    if model.has_light_sensors:
        raise ValueError(f"the model {model.name!r} has infrared sensors, which a batch does not simulate; use n150 or "
                         "scout, or Simulation")
    if not isinstance(setup.sonar, SonarNoise):
        raise ValueError(f"the setup {setup.name!r} has Polaroid sonars, which a batch does not simulate; use ideal, "
                         "noisy or worn, or Simulation")


def _worlds(worlds: World | Sequence[World], robots: int | None) -> list[World]:
    """Return the world of each robot."""
    if isinstance(worlds, World):
        if robots is None or robots < 1:
            raise ValueError(f"expected a number of robots of 1 or more beside one world, got {robots}")
        return [worlds] * robots
    if not worlds or robots not in (None, len(worlds)):
        raise ValueError(f"expected one world, or one for each of {robots} robots, got {len(worlds)}")
    return list(worlds)


def _settings(kernel: Any, model: RobotModel, setup: RobotSetup) -> batch_kernel.Records:
    """Return the record of what all robots share (1,)."""
    settings: npt.NDArray[np.void] = np.zeros(1, kernel.SETTINGS_DTYPE)
    row, ring, noise, odometry, sonar = settings[0], model.body.ring, setup.motion, setup.odometry, setup.sonar
    assert isinstance(sonar, SonarNoise)
    # 1. Motion.
    row["limits"] = [(axis.top_speed, axis.speed, axis.acceleration) for axis in model.axes]
    row["has_ramps"] = setup.ramps
    row["track_in"] = NO_TRACK if model.track_in is None else model.track_in
    row["alphas"] = noise.alpha1, noise.alpha2, noise.alpha3, noise.alpha4
    row["scales"], row["drifts"], row["slip_in"] = odometry.scales, odometry.drifts, odometry.slip_in
    row["has_exact_motion"] = setup.has_exact_motion
    row["has_motion_noise"] = noise != NO_NOISE
    row["has_axis_errors"] = odometry.scales[:2] != (1.0, 1.0) or odometry.drifts != (0.0, 0.0)
    # 2. The body.
    row["radius_in"] = model.body.radius_in
    bumpers = row["bumpers"] = len(model.body.bumper_angles_rad)
    row["bumper_angles_rad"][:bumpers] = model.body.bumper_angles_rad
    # 3. The sonars.
    sonars = row["sonars"] = ring.count
    row["ring_in"], row["turned_rad"] = ring.radius_in, sonar.turned_rad
    row["sonar_angles_rad"][:sonars] = ring.angles_rad
    row["has_shifts"] = bool(ring.shifts_in)
    row["shifts_in"][:sonars] = ring.shifts_in or 0.0
    row["offsets_in"][:sonars] = [sonar.offset_in(number) for number in range(sonars)]
    row["is_dead"][:sonars] = [number in sonar.dead for number in range(sonars)]
    row["min_range_in"], row["max_range_in"] = ring.min_range_in, ring.max_range_in
    row["resolution_in"], row["no_echo_in"] = ring.resolution_in, ring.no_echo_in
    row["has_sonar_noise"] = sonar.has_noise
    row["range_std_relative"], row["range_std_floor_in"] = sonar.range_std_relative, sonar.range_std_floor_in
    _set_order(settings, ring.firing, round(ring.interval_s * PS_PER_S))
    return settings


def _set_order(settings: batch_kernel.Records, firing: Sequence[Sequence[int]], interval_ps: int) -> None:
    """Set the firing order of the rings."""
    row, order = settings[0], [number for group in firing for number in group]
    row["entries"], row["interval_ps"] = len(firing), interval_ps
    row["order"][: len(order)] = order
    row["starts"][: len(firing) + 1] = np.cumsum([0, *map(len, firing)])
