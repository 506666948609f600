"""A summary as a table for people.

Rules: text in, text out; what the numbers are worth is said beside them, never worked into them.
"""

from __future__ import annotations

import math

from localization.experiments.results import Summary
from localization.experiments.settings import Course, Figure


def table(figure: Figure, course: Course, summary: Summary) -> str:
    """The summary, a line a number, each beside what it is measured against."""
    thesis = summary["steps_thesis"]
    rows = [
        ("seeds", f"{summary['seeds']}", ""),
        ("every goal reached", f"{summary['reached']}", f"of {summary['seeds']}, by the estimate"),
        ("steps, median", f"{summary['steps_median']:g}", f"{thesis} in the text" if thesis else ""),
        ("end error, median", f"{summary['end_error_median_in']:.3f} in", "between estimate and truth"),
        ("position RMSE", f"{summary['rmse_position_in']:.4f} in", _beside_bound(summary)),
        ("heading RMSE", f"{summary['rmse_heading_deg']:.3f} deg", ""),
    ]
    if summary["nees_mean"] is not None and summary["nees_band95"] is not None:
        low, high = summary["nees_band95"]
        rows.append(("NEES, mean", f"{summary['nees_mean']:.2f}", f"3 is right, 95 % band {low:.2f} to {high:.2f}"))
    if summary["nis_mean"] is not None:
        rows.append(("NIS a beam, mean", f"{summary['nis_mean']:.3f}", "1 is right"))
    lines = [f"Figure {figure.name}: {figure.title}"]
    lines += [f"  {name:20}{value:>12}  {note}".rstrip() for name, value, note in rows]
    return "\n".join([*lines, *_step_note(course, summary)])


def _beside_bound(summary: Summary) -> str:
    bound = summary["pcrb_position_in"]
    if bound is None:
        return ""
    return f"{summary['rmse_position_in'] / bound:.3f} x the Cramer-Rao bound of {bound:.4f} in"


def _step_note(course: Course, summary: Summary) -> list[str]:
    """Where the text counts fewer steps than the printed law needs, say so."""
    thesis = summary["steps_thesis"]
    stride = course.gains.drho_max_in
    if thesis is None or thesis >= course.least_steps:
        return []
    near = math.ceil((course.length_in - course.waypoint_radius_in) / stride)
    return [
        f"  The text's {thesis} steps cannot be: {course.length_in:.1f} in at {stride:g} in a step take"
        f" {course.least_steps} at least",
        f"  ({near} to come within {course.waypoint_radius_in:g} in). The law is as printed; the count is ours.",
    ]
