"""From what was found out to what is said: link and firmware here, the sensors in sensors.py. Pure.

    a link   fails where one gs in ten is lost or nobody answers; one lost, stray bytes or slow answers are a warning
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

from nclient.doctor import sensors
from nclient.doctor.examination import Chart
from nclient.doctor.finding import Finding, fail, ok, warn
from nclient.protocol.models import model_named

MOST_LOST: Final = 0.1
SLOW_S: Final = 0.2
"""A 99th percentile above this is too slow for a program that asks at 10 Hz while it drives."""
_FAULTS: Final = ("skipped_bytes", "checksum_errors", "misfits", "implausible", "strays", "naks")


def report(chart: Chart) -> list[Finding]:
    """All findings, in the order one would look."""
    findings = [_link(chart)]
    if not chart.states:
        return findings
    findings += _line_faults(chart)
    findings += [_firmware(chart), sensors.motion(chart.states), sensors.clock(chart.states, chart.elapsed_s)]
    findings += sensors.sonars(chart.states)
    if model_named(chart.model).has_infrared:
        findings += sensors.infrareds(chart.states)
    return [*findings, sensors.bumpers(chart.states), *sensors.batteries(chart.states[-1])]


def percentile_s(latencies: Sequence[float], share: float) -> float:
    """The smallest latency that at least this share (0 to 1) of them do not exceed (nearest rank)."""
    ranked = sorted(latencies)
    return ranked[max(0, math.ceil(share * len(ranked)) - 1)]


def _link(chart: Chart) -> Finding:
    lost = len(chart.losses)
    if not chart.states:
        return fail("link", f"no answer to {lost} questions: {chart.losses[-1]}",
                    "is it switched on, the cable in, the address and the model right?")
    half, most = (1000 * percentile_s(chart.latencies, share) for share in (0.5, 0.99))
    seen = f"{len(chart.states)} of {chart.asked} gs answered; {half:.2f} ms p50, {most:.2f} ms p99"
    if lost > MOST_LOST * chart.asked:
        return fail("link", f"{seen}; {chart.losses[-1]}", "look after plugs, baud rate, and who else talks to it")
    if lost:
        return warn("link", f"{seen}; {chart.losses[-1]}", "a noisy line; retries= in the address lets programs go on")
    if most > 1000 * SLOW_S:
        return warn("link", f"{seen}: slow", "a modem in between, or a busy machine? timeout_s= may have to be longer")
    return ok("link", seen)


def _line_faults(chart: Chart) -> list[Finding]:
    faults = [f"{chart.link[name]} {name.replace('_', ' ')}" for name in _FAULTS if chart.link.get(name)]
    if faults:
        return [warn("line", ", ".join(faults), "the line is not clean: look after plugs, length, and ground")]
    return [ok("line", "no stray byte, no bad checksum")] if chart.link else []


def _firmware(chart: Chart) -> Finding:
    bad = {name: told for name, told in chart.answers.items() if told}
    if bad:
        return fail("firmware", "no good answer to " + "; ".join(f"{name} ({told})" for name, told in bad.items()),
                    f"is it a {chart.model}? model= in the address says which")
    return ok("firmware", f"a {chart.model} answered {' '.join(chart.answers)}")
