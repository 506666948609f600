"""Drawing a world and robots with matplotlib (extra `plot`): for pictures of runs, experiments and environments.

Nothing is drawn on the screen: figures are created without pyplot, so no backend is selected and no state is shared.
matplotlib is imported where it is needed.
"""

from __future__ import annotations

import math
from functools import cache
from io import BytesIO
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import numpy.typing as npt

from nclient.errors import ExtraMissing, install_command
from worlds.geometry import FloatArray
from worlds.robots import Body

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Picture

TRUTH: Final = "#1b1b1b"
ESTIMATE: Final = "#d1495b"
ODOMETRY: Final = "#3d7ea6"
GOAL: Final = "#2e8b57"
WALL: Final = "#52616b"
FAINT: Final = "#9fb4c7"

CIRCLE_POINTS: Final = 60


class PlotExtraMissing(ExtraMissing):
    """matplotlib is required and not installed; the message names the extra."""


def require_matplotlib() -> None:
    """Raise PlotExtraMissing if matplotlib is missing, before a long run instead of after it."""
    try:
        import matplotlib.figure  # noqa: F401
    except ImportError as error:
        message = f"pictures need matplotlib: {install_command('plot')}; or run without pictures"
        raise PlotExtraMissing(message) from error


def blank(width_in: float, height_in: float) -> Picture:
    """Return an empty picture of this size in inches on paper; notebooks show it."""
    picture: Picture = _figure_class()(figsize=(width_in, height_in), layout="constrained", facecolor="white")
    return picture


@cache
def _figure_class() -> Any:
    """Return a figure that shows itself in notebooks, which otherwise only those of pyplot do."""
    from matplotlib.figure import Figure as MatplotlibFigure

    class NotebookFigure(MatplotlibFigure):
        def _repr_png_(self) -> bytes:
            written = BytesIO()
            self.savefig(written, format="png")
            return written.getvalue()

    return NotebookFigure


def pixels(picture: Picture) -> npt.NDArray[np.uint8]:
    """Return a picture as pixels (height, width, 3), red, green and blue from 0 to 255."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    canvas = FigureCanvasAgg(picture)
    canvas.draw()  # type: ignore[no-untyped-call]
    return np.array(canvas.buffer_rgba())[..., :3]  # type: ignore[no-untyped-call]


def draw_walls(axes: Axes, walls: npt.ArrayLike) -> None:
    """Draw wall segments (m, 4) in inches."""
    for x1, y1, x2, y2 in np.asarray(walls):
        axes.plot([x1, x2], [y1, y2], color=WALL, linewidth=3, solid_capstyle="round")


def draw_body(axes: Axes, pose: FloatArray, body: Body, color: str) -> None:
    """Draw the outline of a robot at a pose (3,) and its heading."""
    axes.plot(*(pose[:2] + body.radius_in * circle()).T, color=color, linewidth=1, alpha=0.7)
    nose = pose[:2] + body.radius_in * np.array([math.cos(pose[2]), math.sin(pose[2])])
    axes.plot([pose[0], nose[0]], [pose[1], nose[1]], color=color, linewidth=1, alpha=0.7)


def circle() -> FloatArray:
    """Return points (k, 2) of the unit circle."""
    angle = np.linspace(0.0, 2.0 * np.pi, CIRCLE_POINTS)
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1)
