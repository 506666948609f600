"""Whether a daemon lasts: 24 simulated hours, three robots, noise, faults on every line, clients coming and going.

    scripts/soak [--hours 24] [--visitors 3] [--rest 60] [--seed 1] [--every 30] [--out FILE.json]

Target: memory within 5 % after the first hour, clock and steps the same, no task and no descriptor left over.

The daemon is a process of its own, time as fast as it goes (--speed max); its visitors (soak_visitors.py) are real
clients over real sockets. Every 30 simulated minutes all leave, the daemon tidies up, and what is there then is
counted. Each number is printed beside its bound (soak_verdict.py), and the exit code is 1 where one is broken.
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

from soak_verdict import Finding, Sample, ended, verdict, visited
from soak_visitors import KINDS, MODELS, House, ask_owner

from nclient.common.process import handle_termination_signals
from nserver_emu.server.garbage_collection import MIN_INTERVAL_S

PATIENCE_S: Final = 600.0
"""How long a daemon on a machine that others load may take to answer: no verdict on speed."""
QUIET_S: Final = 600.0
"""Real time that a daemon may take to notice that all are gone."""
AUTOSAVE_S: Final = 5
LOOK_S: Final = 0.2
LOOKS: Final = 3
"""Descriptors and memory are counted so often: the fewest are there to stay, others belong to whoever asked for the
numbers, and to a save that is under way."""
SETTLE_S: Final = MIN_INTERVAL_S + 2.0
"""Real time for garbage collection (nserver_emu/server/garbage_collection.py) while simulated time is paused."""
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
name = "the plug is pulled"
do = "hang_up"
every = 600
"""


@dataclass(frozen=True, slots=True)
class Wanted:
    """So many visitors at a time, each resting so many simulated seconds from visit to visit, in the mean; a count
    every so many."""

    visitors: int
    rest_s: float
    every_s: float


@dataclass
class Daemon:
    """The process under test, and where it is reached."""

    process: subprocess.Popen[str]
    house: House
    log: Path
    began_s: float

    def sample(self) -> Sample:
        """What it is now, by its own numbers and by the system's."""
        told, place = self.numbers(), Path(f"/proc/{self.process.pid}")
        descriptors, looks = [], []
        for _ in range(LOOKS):
            time.sleep(LOOK_S)
            descriptors.append(sum(1 for _ in (place / "fd").iterdir()))
            looks.append(dict(line.split(":", 1) for line in (place / "status").read_text().splitlines()))
        return Sample(
            time.monotonic() - self.began_s, told["simulated_seconds"], int(told["steps_total"]),
            min(int(status["VmRSS"].split()[0]) for status in looks), min(descriptors), int(looks[-1]["Threads"]),
            int(told["tasks"]), int(told["answers_total"]), int(told["shapes"]), int(told["obstacles"]),
        )  # fmt: skip

    def numbers(self) -> dict[str, float]:
        """/metrics, by their names without `nserver_`."""
        with urllib.request.urlopen(self.house.page.partition("/?")[0] + "/metrics", timeout=PATIENCE_S) as answer:
            lines = answer.read().decode().splitlines()
        rows = (line.removeprefix("nserver_").split() for line in lines if not line.startswith("#"))
        return {name: float(value) for name, value in rows}

    def complaints(self) -> int:
        """How many faults of its own it logged."""
        return sum(self.log.read_text().count(word) for word in COMPLAINTS)


@contextlib.contextmanager
def running(folder: Path, seed: int) -> Iterator[Daemon]:
    """A daemon with three robots and everything on; told to end with the block."""
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
            said = [process.stdout.readline().split() for _ in range(5)]
            places = {words[1]: words[2] for words in said if words}
            if len(places) < len(said):
                raise SystemExit(f"the daemon did not start: {log.read_text()}")
            house = House(_port(places["nserver"]), _port(places["robotd"]), str(link), str(control), places["viewer"])
            yield Daemon(process, house, log, time.monotonic())
        finally:
            process.terminate()


def _port(place: str) -> int:
    return int(place.rpartition(":")[2])


async def soak(daemon: Daemon, hours: float, wanted: Wanted, rng: random.Random) -> list[Sample]:
    """The samples of a run: before anybody came, then every so many simulated seconds, for so many hours from then."""
    samples = [await _quiet(daemon)]
    end_s = samples[0].simulated_s + 3600 * hours
    while samples[-1].simulated_s < end_s:
        until_s = min(samples[-1].simulated_s + wanted.every_s, end_s)
        go_on = asyncio.Event()
        chances = [random.Random(rng.random()) for _ in range(wanted.visitors)]
        going = [asyncio.create_task(_visits(daemon.house, chance, wanted.rest_s, go_on)) for chance in chances]
        while daemon.house.now_s < until_s:
            await asyncio.sleep(LOOK_S)
            daemon.house.now_s = (await asyncio.to_thread(daemon.numbers))["simulated_seconds"]
        go_on.set()
        await asyncio.gather(*going)
        samples.append(await _quiet(daemon))
        _tell(samples[-1], daemon.house)
    return samples


async def _visits(house: House, rng: random.Random, rest_s: float, enough: asyncio.Event) -> None:
    """One after the other: every kind in its turn, in an order of chance; once in any case."""
    rounds = 0
    while not enough.is_set():
        for kind in rng.sample(sorted(KINDS), len(KINDS)):
            if not (rounds and enough.is_set()):
                await house.context(kind, rng)
                again_s = house.now_s + rng.uniform(0.0, 2.0 * rest_s)
                while house.now_s < again_s and not enough.is_set():
                    await asyncio.sleep(LOOK_S)
        rounds += 1


async def _quiet(daemon: Daemon) -> Sample:
    """When the daemon has noticed that nobody is there, and tidied up; time stands meanwhile."""
    end_s = time.monotonic() + QUIET_S
    while True:
        told = await asyncio.to_thread(daemon.numbers)
        if not told["connections"] and not told["viewers"]:
            break
        if time.monotonic() > end_s:
            raise SystemExit(f"after {QUIET_S:g} s still there: {told}, {await ask_owner(daemon.house, 'status')}")
        await asyncio.sleep(LOOK_S)
    await ask_owner(daemon.house, "pause")
    await asyncio.sleep(SETTLE_S)
    sample = await asyncio.to_thread(daemon.sample)
    await ask_owner(daemon.house, "resume")
    return sample


def _tell(sample: Sample, house: House) -> None:
    visits, failed = sum(house.visits.values()), sum(house.failed.values())
    print(f"{sample.simulated_s / 3600:6.2f} h after {sample.real_s:5.0f} s: {sample.rss_kib} KiB, "
          f"{sample.descriptors} descriptors, {sample.threads} threads, {sample.tasks} tasks, "
          f"{sample.answers} answers, {visits} visits, {failed} broken off by faults", flush=True)


async def _struck(house: House) -> int:
    found = await ask_owner(house, "status")
    faults: Any = found["faults"]
    return sum(faults["struck"].values())


def run(hours: float, wanted: Wanted, seed: int) -> tuple[list[Sample], House, list[Finding]]:
    """The whole run, and what was found."""
    with tempfile.TemporaryDirectory(prefix="soak") as name:
        with running(Path(name), seed) as daemon:
            samples = asyncio.run(soak(daemon, hours, wanted, random.Random(seed)))
            struck = asyncio.run(_struck(daemon.house))
        found = [*verdict(samples, hours), *visited(daemon.house.visits, struck, list(KINDS)),
                 *ended(daemon.process.returncode, daemon.complaints())]  # fmt: skip
        if daemon.complaints():
            print(daemon.log.read_text()[-5000:], file=sys.stderr)
    return samples, daemon.house, found


def main(arguments: Sequence[str] | None = None) -> int:
    """Run, print, judge."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--hours", type=float, default=24.0, help="simulated hours (default %(default)s)")
    parser.add_argument("--visitors", type=int, default=3, help="at a time (default %(default)s)")
    parser.add_argument("--rest", type=float, default=60.0,
                        help="simulated seconds from visit to visit of each, in the mean (60)")
    parser.add_argument("--every", type=float, default=30.0, help="simulated minutes from count to count (30)")
    parser.add_argument("--seed", type=int, default=1, help="of noise and visitors (default %(default)s)")
    parser.add_argument("--out", type=Path, metavar="FILE.json", help="write samples, visits and findings to a file")
    options = parser.parse_args(arguments)
    wanted = Wanted(options.visitors, options.rest, 60 * options.every)
    with handle_termination_signals():  # a run that is ended leaves no daemon behind
        samples, house, found = run(options.hours, wanted, options.seed)
    for finding in found:
        print(f"{'kept  ' if finding.kept else 'BROKEN'} {finding.what}: {finding.value:.6g} (asked: {finding.bound})")
    if options.out:
        whole = {"samples": samples, "findings": found}
        told = {name: [asdict(row) for row in rows] for name, rows in whole.items()}
        options.out.write_text(json.dumps(told | {"visits": house.visits, "broken_off": house.failed}, indent=1) + "\n")
    return 0 if all(finding.kept for finding in found) else 1


if __name__ == "__main__":
    raise SystemExit(main())
