"""Endurance run of a daemon: 24 simulated hours, three robots, noise, faults on all lines, connecting clients.

    scripts/soak [--hours 24] [--clients 3] [--rest 60] [--seed 1] [--every 30] [--out FILE.json]

Target: memory within 5 % after the first hour, clock and steps the same, no task and no descriptor left over.

The daemon is a process of its own at --speed max; its clients (soak_clients.py) use real sockets. Every 30 simulated
minutes all clients disconnect, the daemon collects garbage, and its resources are counted. Each number is printed with
its bound (soak_verdict.py); the exit code is 1 if a bound is exceeded.
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

from soak_clients import KINDS, MODELS, Target, control_request
from soak_verdict import Finding, Sample, check_activity, check_end, check_samples

from nclient.common.process import handle_termination_signals
from nserver_emu.server.daemon import MIN_INTERVAL_S

TIMEOUT_S: Final = 600.0
"""Time-out of a reply on a busy machine; speed is not judged here."""
QUIET_S: Final = 600.0
"""Real time within which the daemon must notice that all clients are gone."""
AUTOSAVE_S: Final = 5
LOOK_S: Final = 0.2
LOOKS: Final = 3
"""Number of counts of descriptors and memory, of which the smallest counts: others include this request for metrics,
and a save in progress."""
SETTLE_S: Final = MIN_INTERVAL_S + 2.0
"""Real time for garbage collection (nserver_emu/server/daemon.py) while simulated time is paused."""
COMPLAINTS: Final = ("Traceback", "was never retrieved", "was destroyed")
FAULTS: Final = """
seed = 1
[[rule]]
name = "a faulty byte in every two-hundredth reply"
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
name = "disconnected"
do = "hang_up"
every = 600
"""


@dataclass(frozen=True, slots=True)
class Load:
    """Number of simultaneous clients, mean pause between two sessions of each, and interval between counts, in s."""

    clients: int
    rest_s: float
    every_s: float


@dataclass
class Daemon:
    """The process under test and its addresses."""

    process: subprocess.Popen[str]
    target: Target
    log: Path
    began_s: float

    def sample(self) -> Sample:
        """Return the present resources, by /metrics and by /proc."""
        metrics, place = self.numbers(), Path(f"/proc/{self.process.pid}")
        descriptors, looks = [], []
        for _ in range(LOOKS):
            time.sleep(LOOK_S)
            descriptors.append(sum(1 for _ in (place / "fd").iterdir()))
            looks.append(dict(line.split(":", 1) for line in (place / "status").read_text().splitlines()))
        return Sample(
            time.monotonic() - self.began_s, metrics["simulated_seconds"], int(metrics["steps_total"]),
            # The smallest of several counts: a request or a save adds to the others.
            min(int(status["VmRSS"].split()[0]) for status in looks), min(descriptors), int(looks[-1]["Threads"]),
            int(metrics["tasks"]), int(metrics["answers_total"]), int(metrics["shapes"]), int(metrics["obstacles"]),
        )  # fmt: skip

    def numbers(self) -> dict[str, float]:
        """Return /metrics by name, without the prefix `nserver_`."""
        with urllib.request.urlopen(self.target.page.partition("/?")[0] + "/metrics", timeout=TIMEOUT_S) as answer:
            lines = answer.read().decode().splitlines()
        rows = (line.removeprefix("nserver_").split() for line in lines if not line.startswith("#"))
        return {name: float(value) for name, value in rows}

    def complaints(self) -> int:
        """Return the number of internal errors in its log."""
        return sum(self.log.read_text().count(word) for word in COMPLAINTS)


@contextlib.contextmanager
def running(folder: Path, seed: int) -> Iterator[Daemon]:
    """Run a daemon with three robots and all features; end it with the block."""
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
            # One line for each listener: robots, robotd, serial link, control socket and page.
            lines = [process.stdout.readline().split() for _ in range(5)]
            places = {words[1]: words[2] for words in lines if words}
            if len(places) < len(lines):
                raise SystemExit(f"the daemon did not start: {log.read_text()}")
            ports = _port(places["nserver"]), _port(places["robotd"])
            target = Target(*ports, str(link), str(control), places["viewer"])
            yield Daemon(process, target, log, time.monotonic())
        finally:
            process.terminate()


def _port(place: str) -> int:
    return int(place.rpartition(":")[2])


async def soak(daemon: Daemon, hours: float, load: Load, rng: random.Random) -> list[Sample]:
    """Return the samples of a run: before the first client, then at the load's interval for this many hours."""
    samples = [await _quiet(daemon)]
    end_s = samples[0].simulated_s + 3600 * hours
    while samples[-1].simulated_s < end_s:
        until_s = min(samples[-1].simulated_s + load.every_s, end_s)
        go_on = asyncio.Event()
        # A generator for each client, so that the order of their tasks does not change their choices.
        rngs = [random.Random(rng.random()) for _ in range(load.clients)]
        clients = [_run_clients(daemon.target, client_rng, load.rest_s, go_on) for client_rng in rngs]
        tasks = [asyncio.create_task(client) for client in clients]
        while daemon.target.now_s < until_s:
            await asyncio.sleep(LOOK_S)
            daemon.target.now_s = (await asyncio.to_thread(daemon.numbers))["simulated_seconds"]
        go_on.set()
        await asyncio.gather(*tasks)
        samples.append(await _quiet(daemon))
        _print_sample(samples[-1], daemon.target)
    return samples


async def _run_clients(target: Target, rng: random.Random, rest_s: float, enough: asyncio.Event) -> None:
    """Run sessions of all kinds in random order, again and again; each kind at least once."""
    rounds = 0
    while not enough.is_set():
        for kind in rng.sample(sorted(KINDS), len(KINDS)):
            # Each kind at least once, even if the time is over.
            if not (rounds and enough.is_set()):
                await target.run_session(kind, rng)
                again_s = target.now_s + rng.uniform(0.0, 2.0 * rest_s)
                while target.now_s < again_s and not enough.is_set():
                    await asyncio.sleep(LOOK_S)
        rounds += 1


async def _quiet(daemon: Daemon) -> Sample:
    """Wait until the daemon has no connections and has collected garbage; return a sample, time being paused."""
    end_s = time.monotonic() + QUIET_S
    while True:
        metrics = await asyncio.to_thread(daemon.numbers)
        if not metrics["connections"] and not metrics["viewers"]:
            break
        if time.monotonic() > end_s:
            status = await control_request(daemon.target, "status")
            raise SystemExit(f"still connected after {QUIET_S:g} s: {metrics}, {status}")
        await asyncio.sleep(LOOK_S)
    # Paused, so that clock and number of steps belong to the same moment.
    await control_request(daemon.target, "pause")
    await asyncio.sleep(SETTLE_S)
    sample = await asyncio.to_thread(daemon.sample)
    await control_request(daemon.target, "resume")
    return sample


def _print_sample(sample: Sample, target: Target) -> None:
    sessions, failed = sum(target.sessions.values()), sum(target.failed.values())
    print(f"{sample.simulated_s / 3600:6.2f} h after {sample.real_s:5.0f} s: {sample.rss_kib} KiB, "
          f"{sample.descriptors} descriptors, {sample.threads} threads, {sample.tasks} tasks, "
          f"{sample.answers} answers, {sessions} sessions, {failed} ended by faults", flush=True)


async def _struck(target: Target) -> int:
    found = await control_request(target, "status")
    faults: Any = found["faults"]
    return sum(faults["struck"].values())


def run(hours: float, load: Load, seed: int) -> tuple[list[Sample], Target, list[Finding]]:
    """Run everything; return samples, target and findings."""
    with tempfile.TemporaryDirectory(prefix="soak") as name:
        with running(Path(name), seed) as daemon:
            samples = asyncio.run(soak(daemon, hours, load, random.Random(seed)))
            struck = asyncio.run(_struck(daemon.target))
        found = [*check_samples(samples, hours), *check_activity(daemon.target.sessions, struck, list(KINDS)),
                 *check_end(daemon.process.returncode, daemon.complaints())]  # fmt: skip
        if daemon.complaints():
            print(daemon.log.read_text()[-5000:], file=sys.stderr)
    return samples, daemon.target, found


def main(arguments: Sequence[str] | None = None) -> int:
    """Run, print the findings, return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--hours", type=float, default=24.0, help="simulated hours (default %(default)s)")
    parser.add_argument("--clients", type=int, default=3, help="number of simultaneous clients (default %(default)s)")
    parser.add_argument("--rest", type=float, default=60.0,
                        help="mean pause between two sessions of a client, in simulated seconds (60)")
    parser.add_argument("--every", type=float, default=30.0, help="interval between counts, in simulated minutes (30)")
    parser.add_argument("--seed", type=int, default=1, help="seed of noise and clients (default %(default)s)")
    parser.add_argument("--out", type=Path, metavar="FILE.json", help="write samples, sessions and findings to a file")
    options = parser.parse_args(arguments)
    load = Load(options.clients, options.rest, 60 * options.every)
    with handle_termination_signals():  # an interrupted run leaves no daemon behind
        samples, target, found = run(options.hours, load, options.seed)
    for finding in found:
        mark = "ok    " if finding.is_met else "BROKEN"
        print(f"{mark} {finding.what}: {finding.value:.6g} (bound: {finding.bound})")
    if options.out:
        whole: dict[str, Sequence[Sample | Finding]] = {"samples": samples, "findings": found}
        report: dict[str, Any] = {name: [asdict(row) for row in rows] for name, rows in whole.items()}
        report |= {"sessions": target.sessions, "broken_off": target.failed}
        options.out.write_text(json.dumps(report, indent=1) + "\n")
    return 0 if all(finding.is_met for finding in found) else 1


if __name__ == "__main__":
    raise SystemExit(main())
