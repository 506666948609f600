"""Elements common to all pictures. The picture of a live run is tested with the command that draws it."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from localization import plot
from nclient.errors import NomadError, OutputFileError
from worlds import drawing


def test_an_ellipse_lies_its_sigmas_away() -> None:
    cov = np.array([[2.0, 0.5, 0.0], [0.5, 1.0, 0.0], [0.0, 0.0, 1.0]])
    outline = plot.ellipse(np.array([5.0, 6.0, 0.0]), cov, 3.0) - (5.0, 6.0)
    # Points at three standard deviations have a squared Mahalanobis distance of 9.
    distances = (outline @ np.linalg.inv(cov[:2, :2]) * outline).sum(axis=-1)
    assert distances == pytest.approx(np.full(len(outline), 9.0))


def test_without_matplotlib_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    drawing.require_matplotlib()
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(drawing.PlotExtraMissing, match=r"\[plot\]") as caught:
        drawing.require_matplotlib()
    assert isinstance(caught.value, NomadError)
    assert isinstance(caught.value, ImportError)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="the system has no /dev/full")
def test_a_picture_that_cannot_be_written_is_reported(tmp_path: Path) -> None:
    (tmp_path / "full.png").symlink_to("/dev/full")
    with pytest.raises(OutputFileError, match=r"full\.png: .*No space"):
        plot.save(drawing.blank(1.0, 1.0), tmp_path / "full.png")
    (tmp_path / "file").touch()
    with pytest.raises(OutputFileError, match=r"run\.png: .*written"):
        plot.save(drawing.blank(1.0, 1.0), tmp_path / "file" / "run.png")
