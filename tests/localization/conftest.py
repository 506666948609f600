"""A map of another frame than its world; without the extra `gym` its tests are not collected."""

from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from worlds.io import format_world, load_world
from worlds.world import WallAccuracy, World

collect_ignore_glob = ["test_gym.py"] if find_spec("pettingzoo") is None else []


@pytest.fixture
def learned(tmp_path: Path) -> str:
    """Return a map of several_walls with its origin at (5, 5) and turned by 90 degrees, as learned there."""
    quarter = np.array(((0.0, 1.0), (-1.0, 0.0)))
    walls = (load_world("several_walls").walls.reshape(-1, 2) - 5.0) @ quarter
    accuracies = dict.fromkeys(range(len(walls) // 2), WallAccuracy(0.1, 0.001, 90.0))
    file = tmp_path / "learned.toml"
    file.write_text(format_world(World("learned", inner_walls=walls.reshape(-1, 4), accuracies=accuracies)))
    return str(file)
