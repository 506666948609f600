"""Endurance test of a daemon: 24 simulated hours, three robots, noise, faults on every line, changing clients.

    scripts/soak [--hours 24] [--clients 3] [--rest 60] [--seed 1] [--every 30] [--out FILE.json]

Target: memory within 5 % after the first hour, clock equal to steps, no task and no descriptor left over.

The daemon is a process of its own at maximum speed; its clients (soak_clients.py) use real sockets. Every 30 simulated
minutes all clients disconnect, the daemon cleans up, and its resources are counted. Each number is printed with its
limit (soak_verdict.py), and the exit code is 1 if a limit is exceeded.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import random
import subprocess
import sys
import tempfile
import time
import urllib.request
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

from soak_clients import KINDS, MODELS, Endpoints, send_control
from soak_verdict import Finding, Sample, check_activity, check_exit, verdict

from nclient.common.process import handle_termination_signals
from nserver_emu.server.garbage_collection import MIN_INTERVAL_S

TIMEOUT_S: Final = 600.0
"""Time-out of requests, long enough for a loaded machine: speed is not tested."""
IDLE_TIMEOUT_S: Final = 600.0
"""Real time in which the daemon must notice that all clients are disconnected."""
AUTOSAVE_S: Final = 5
POLL_S: Final = 0.2
SAMPLES: Final = 3
"""Counts of descriptors and memory; the minimum is used, as others include a metrics request or a running save."""
SETTLE_S: Final = MIN_INTERVAL_S + 2.0
"""Real time for garbage collection (nserver_emu/server/garbage_collection.py) while simulated time is paused."""
ERROR_WORDS: Final = ("Traceback", "was never retrieved", "was destroyed")
FAULTS: Final = """
seed = 1
[[rule]]
name = "one faulty byte per 200 replies"
do = ["corrupt", "drop_byte", "stray"]
every = 200
[[rule]]
name = "lost"
do = "drop"
direction = "both"
percent = 0.2
[[rule]]
name = "late"
do = "delay"
delay_s = 0.02
jitter_s = 0.01
percent = 5.0
[[rule]]
name = "hang up"
do = "hang_up"
every = 600
"""


@dataclass(frozen=True, slots=True)
class LoadPlan:
    """Number of clients, mean simulated seconds between sessions of each, and between samples."""

    clients: int
    rest_s: float
    every_s: float


@dataclass
class Daemon:
    """The process under test and its addresses."""

    process: subprocess.Popen[str]
    endpoints: Endpoints
    log: Path
    started_s: float

    def sample(self) -> Sample:
        """Take a sample from its metrics and from the system."""
        metrics, place = self.numbers(), Path(f"/proc/{self.process.pid}")
        descriptors, looks = [], []
        for _ in range(SAMPLES):
            time.sleep(POLL_S)
            descriptors.append(sum(1 for _ in (place / "fd").iterdir()))
            looks.append(dict(line.split(":", 1) for line in (place / "status").read_text().splitlines()))
        return Sample(
            time.monotonic() - self.started_s, metrics["simulated_seconds"], int(metrics["steps_total"]),
            min(int(status["VmRSS"].split()[0]) for status in looks), min(descriptors), int(looks[-1]["Threads"]),
            int(metrics["tasks"]), int(metrics["answers_total"]), int(metrics["shapes"]), int(metrics["obstacles"]),
        )  # fmt: skip

    def numbers(self) -> dict[str, float]:
        """Return the values of /metrics, by name without `nserver_`."""
        with urllib.request.urlopen(self.endpoints.page.partition("/?")[0] + "/metrics", timeout=TIMEOUT_S) as answer:
            lines = answer.read().decode().splitlines()
        rows = (line.removeprefix("nserver_").split() for line in lines if not line.startswith("#"))
        return {name: float(value) for name, value in rows}

    def count_errors(self) -> int:
        """Return the number of internal errors in its log."""
        return sum(self.log.read_text().count(word) for word in ERROR_WORDS)


@contextlib.contextmanager
def run_daemon(folder: Path, seed: int) -> Iterator[Daemon]:
    """Run a daemon with three robots and all features during the block."""
    (folder / "faults.toml").write_text(FAULTS)
    link, control, log = folder / "robot", folder / "ctl.sock", folder / "log"
    robots = [word for model in MODELS for word in ("--robot", model)]
    command = [
        sys.executable, "-m", "nserver_emu", "several_walls", *robots, "--setup", "worn", "--seed", str(seed),
        "--port", "0", "--speed", "max", "--robotd", "0@1", "--serial-link", f"{link}@2",
        "--faults", str(folder / "faults.toml"), "--control", str(control), "--viewer", "0",
        "--save", str(folder / "saved.json"), "--autosave", str(AUTOSAVE_S),
    ]  # fmt: skip
    pipe = subprocess.PIPE
    with log.open("w") as stderr, subprocess.Popen(command, stdout=pipe, stderr=stderr, text=True) as process:
        try:
            assert process.stdout is not None
            lines = [process.stdout.readline().split() for _ in range(5)]
            places = {words[1]: words[2] for words in lines if words}
            if len(places) < len(lines):
                raise SystemExit(f"the daemon did not start: {log.read_text()}")
            nserver, robotd = _port(places["nserver"]), _port(places["robotd"])
            endpoints = Endpoints(nserver, robotd, str(link), str(control), places["viewer"])
            yield Daemon(process, endpoints, log, time.monotonic())
        finally:
            process.terminate()


def _port(place: str) -> int:
    return int(place.rpartition(":")[2])


async def soak(daemon: Daemon, hours: float, plan: LoadPlan, rng: random.Random) -> list[Sample]:
    """Run clients for this many hours and return the samples, the first before any client connects."""
    samples = [await _sample_idle(daemon)]
    end_s = samples[0].simulated_s + 3600 * hours
    while samples[-1].simulated_s < end_s:
        until_s = min(samples[-1].simulated_s + plan.every_s, end_s)
        stop = asyncio.Event()
        rngs = [random.Random(rng.random()) for _ in range(plan.clients)]
        tasks = [asyncio.create_task(_run_clients(daemon.endpoints, rng, plan.rest_s, stop)) for rng in rngs]
        while daemon.endpoints.now_s < until_s:
            await asyncio.sleep(POLL_S)
            daemon.endpoints.now_s = (await asyncio.to_thread(daemon.numbers))["simulated_seconds"]
        stop.set()
        await asyncio.gather(*tasks)
        samples.append(await _sample_idle(daemon))
        _print_sample(samples[-1], daemon.endpoints)
    return samples


async def _run_clients(endpoints: Endpoints, rng: random.Random, rest_s: float, stop: asyncio.Event) -> None:
    """Run sessions of all kinds in random order until stopped, at least one of each."""
    rounds = 0
    while not stop.is_set():
        for kind in rng.sample(sorted(KINDS), len(KINDS)):
            if not (rounds and stop.is_set()):
                await endpoints.run_session(kind, rng)
                again_s = endpoints.now_s + rng.uniform(0.0, 2.0 * rest_s)
                while endpoints.now_s < again_s and not stop.is_set():
                    await asyncio.sleep(POLL_S)
        rounds += 1


async def _sample_idle(daemon: Daemon) -> Sample:
    """Take a sample once no client is connected and the daemon has cleaned up, with time paused."""
    end_s = time.monotonic() + IDLE_TIMEOUT_S
    while True:
        metrics = await asyncio.to_thread(daemon.numbers)
        if not metrics["connections"] and not metrics["viewers"]:
            break
        if time.monotonic() > end_s:
            status = await send_control(daemon.endpoints, "status")
            raise SystemExit(f"not idle after {IDLE_TIMEOUT_S:g} s: {metrics}, {status}")
        await asyncio.sleep(POLL_S)
    await send_control(daemon.endpoints, "pause")
    await asyncio.sleep(SETTLE_S)
    sample = await asyncio.to_thread(daemon.sample)
    await send_control(daemon.endpoints, "resume")
    return sample


def _print_sample(sample: Sample, endpoints: Endpoints) -> None:
    sessions, failed = sum(endpoints.sessions.values()), sum(endpoints.failed.values())
    print(f"{sample.simulated_s / 3600:6.2f} h after {sample.real_s:5.0f} s: {sample.rss_kib} KiB, "
          f"{sample.descriptors} descriptors, {sample.threads} threads, {sample.tasks} tasks, "
          f"{sample.answers} answers, {sessions} sessions, {failed} ended by faults", flush=True)


async def _count_faults(endpoints: Endpoints) -> int:
    found = await send_control(endpoints, "status")
    faults: Any = found["faults"]
    return sum(faults["struck"].values())


def run(hours: float, plan: LoadPlan, seed: int) -> tuple[list[Sample], Endpoints, list[Finding]]:
    """Run the test and return samples, addresses with counts, and findings."""
    with tempfile.TemporaryDirectory(prefix="soak") as name:
        with run_daemon(Path(name), seed) as daemon:
            samples = asyncio.run(soak(daemon, hours, plan, random.Random(seed)))
            struck = asyncio.run(_count_faults(daemon.endpoints))
        found = [*verdict(samples, hours), *check_activity(daemon.endpoints.sessions, struck, list(KINDS)),
                 *check_exit(daemon.process.returncode, daemon.count_errors())]  # fmt: skip
        if daemon.count_errors():
            print(daemon.log.read_text()[-5000:], file=sys.stderr)
    return samples, daemon.endpoints, found


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--hours", type=float, default=24.0, help="simulated hours (default %(default)s)")
    parser.add_argument("--clients", type=int, default=3, help="number of clients (default %(default)s)")
    parser.add_argument("--rest", type=float, default=60.0,
                        help="mean simulated seconds between sessions of a client (60)")
    parser.add_argument("--every", type=float, default=30.0, help="simulated minutes between samples (30)")
    parser.add_argument("--seed", type=int, default=1, help="seed of noise and clients (default %(default)s)")
    parser.add_argument("--out", type=Path, metavar="FILE.json", help="write samples, sessions and findings to a file")
    options = parser.parse_args(arguments)
    plan = LoadPlan(options.clients, options.rest, 60 * options.every)
    with handle_termination_signals():  # an interrupted run leaves no daemon running
        samples, endpoints, found = run(options.hours, plan, options.seed)
    for finding in found:
        result = "passed" if finding.passed else "FAILED"
        print(f"{result} {finding.what}: {finding.value:.6g} (limit: {finding.bound})")
    if options.out:
        results: dict[str, Any] = {
            "samples": [asdict(sample) for sample in samples], "findings": [asdict(finding) for finding in found],
            "sessions": endpoints.sessions, "failed": endpoints.failed,
        }  # fmt: skip
        options.out.write_text(json.dumps(results, indent=1) + "\n")
    return 0 if all(finding.passed for finding in found) else 1


if __name__ == "__main__":
    raise SystemExit(main())
