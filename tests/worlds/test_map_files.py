"""Maps of other tools: ROS, CARMEN, SVG, DXF, bitmaps; worlds written as ROS maps."""

from __future__ import annotations

import gzip
import json
import struct
import sys
from math import pi
from pathlib import Path

import numpy as np
import pytest
import yaml
from PIL import Image

from localization.cli import map as map_command
from nclient.cli.main import main
from nclient.errors import MapFileError
from worlds import map_files
from worlds.geometry import lengths, nearest_points
from worlds.io import load_world
from worlds.map_files import ImportSettings, MapsExtraMissing, read_map_file, write_ros_map
from worlds.world import World

DATA = Path(__file__).parents[3] / "shared" / "data" / "carmen_maps"
IN_PER_M = 1.0 / 0.0254


def box_image(path: Path) -> Path:
    """Write an image of 20 x 10 pixels: a dark border, white inside."""
    pixels = np.zeros((10, 20), dtype=np.uint8)
    pixels[1:-1, 1:-1] = 254
    Image.fromarray(pixels).save(path)
    return path


def ros_map(folder: Path, **changes: object) -> Path:
    values = {"image": "map.pgm", "resolution": 0.1, "origin": [1.0, 2.0, 0.0], "negate": 0,
              "occupied_thresh": 0.65, "free_thresh": 0.196} | changes  # fmt: skip
    box_image(folder / "map.pgm")
    path = folder / "map.yaml"
    path.write_text(yaml.safe_dump({key: value for key, value in values.items() if value is not None}))
    return path


def bounds(world: World) -> list[float]:
    """Return the smallest and largest x and y of the walls in metres."""
    ends = world.walls.reshape(-1, 2) * 0.0254
    return [*ends.min(axis=0), *ends.max(axis=0)]


def test_ros_map_becomes_a_room(tmp_path: Path) -> None:
    found = read_map_file(ros_map(tmp_path))
    # The inner 18 x 8 pixels, from the origin at the lower left corner of the image.
    # 18 x 8 pixels of 0.1 m from (1.0, 2.0), without the border of one pixel.
    assert bounds(found.world) == pytest.approx([1.1, 2.1, 2.9, 2.9], abs=1e-5)
    assert len(found.world.rooms) == 1
    assert found.open_in == 0.0
    start = found.world.starts[0]
    assert found.world.clearance(start.x_in, start.y_in) > 0.3 * IN_PER_M


def test_ros_map_may_be_turned(tmp_path: Path) -> None:
    found = read_map_file(ros_map(tmp_path, origin=[0.0, 0.0, 0.5 * pi]))
    # Turned by 90 degrees about the origin: x becomes y, and y becomes -x.
    assert bounds(found.world) == pytest.approx([-0.9, 0.1, -0.1, 1.9], abs=1e-5)


def test_thresholds_negation_and_raw_mode(tmp_path: Path) -> None:
    # Dark and light change places: free is the border, which is one region around the occupied middle.
    negated = read_map_file(ros_map(tmp_path, negate=1), ImportSettings(close_open_ends=True)).world
    assert bounds(negated) == pytest.approx([1.0, 2.0, 3.0, 3.0], abs=1e-5)
    # Raw: 0 is free, 100 occupied, 254 unknown: the border is free, and nothing is occupied.
    raw = read_map_file(ros_map(tmp_path, mode="raw"), ImportSettings(close_open_ends=True)).world
    assert bounds(raw) == pytest.approx([1.0, 2.0, 3.0, 3.0], abs=1e-5)
    with pytest.raises(MapFileError, match="no walls"):
        # With a threshold of 0 no cell is free.
        read_map_file(ros_map(tmp_path, free_thresh=0.0))


@pytest.mark.parametrize(
    ("changes", "word"),
    [({"image": None}, "image"), ({"resolution": "x"}, "could not convert"), ({"resolution": 0}, "resolution"),
     ({"origin": [0, 0]}, "not enough"), ({"mode": "odd"}, "mode"), ({"image": "absent.pgm"}, "cannot be read")],
)  # fmt: skip
def test_a_bad_map_yaml_is_refused(changes: dict[str, object], word: str, tmp_path: Path) -> None:
    with pytest.raises(MapFileError, match=word):
        read_map_file(ros_map(tmp_path, **changes))


@pytest.mark.parametrize(("name", "text"), [("map.yaml", "[1, 2]"), ("map.yaml", "a: ["), ("map.png", "no picture"),
                                            ("map.map", "no map"), ("map.svg", "<svg"), ("map.dxf", "nothing"),
                                            ("map.txt", "")])  # fmt: skip
def test_malformed_files_are_refused(name: str, text: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(MapFileError, match=name):
        read_map_file(path, ImportSettings(cell_in=1.0))


def test_a_bitmap_needs_its_scale(tmp_path: Path) -> None:
    path = box_image(tmp_path / "plan.png")
    with pytest.raises(MapFileError, match="--cell"):
        read_map_file(path)
    assert bounds(read_map_file(path, ImportSettings(cell_in=IN_PER_M)).world) == pytest.approx([1, 1, 19, 9], abs=1e-5)


def test_transparent_pixels_are_unknown(tmp_path: Path) -> None:
    pixels = np.zeros((10, 20, 4), dtype=np.uint8)
    pixels[..., 3] = 255
    pixels[1:-1, 1:-1] = 255
    # Columns from 15 on are transparent.
    pixels[:, 15:] = 0
    Image.fromarray(pixels).save(tmp_path / "plan.png")
    found = read_map_file(tmp_path / "plan.png", ImportSettings(cell_in=1.0))
    # The open side is 8 pixels high, and each of its ends may move by a pixel.
    assert found.open_in == pytest.approx(6.0, abs=2.0)
    assert not found.world.rooms


def test_images_and_files_have_a_largest_size(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = box_image(tmp_path / "plan.png")
    monkeypatch.setattr(map_files, "MAX_CELLS", 100)
    with pytest.raises(MapFileError, match="too many"):
        read_map_file(path, ImportSettings(cell_in=1.0))
    monkeypatch.setattr(map_files, "MAX_FILE_BYTES", 10)
    with pytest.raises(MapFileError, match="larger"):
        read_map_file(path, ImportSettings(cell_in=1.0))


def carmen(width: int = 20, height: int = 10, *, cells: bytes | None = None) -> bytes:
    """Return a CARMEN map of a box: cells of 0.1 m, probabilities, unknown outside."""
    # Unknown outside, a wall of one cell, free inside; the cells are stored column by column.
    values = np.full((abs(width), height), -1.0, dtype="<f4")
    values[2:-2, 2:-2] = 0.95
    values[3:-3, 3:-3] = 0.01
    body = b"GRIDMAP   " + struct.pack("<iif", width, height, 0.1) + (values.tobytes() if cells is None else cells)
    creator = b"CREATOR   somebody"
    # Chunks of a type, a length and data: 32 is the creator, 1 is the grid.
    chunks = b"".join(bytes([kind]) + struct.pack("<i", len(part)) + part for kind, part in ((32, creator), (1, body)))
    return b"# header\n" + b"CARMENMAPFILEv020" + chunks


@pytest.mark.parametrize("name", ["box.map", "box.map.gz"])
def test_carmen_map_becomes_a_room(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_bytes(gzip.compress(carmen()) if name.endswith("gz") else carmen())
    found = read_map_file(path)
    # Free cells from 3 to 17 and from 3 to 7, of 0.1 m.
    assert bounds(found.world) == pytest.approx([0.3, 0.3, 1.7, 0.7], abs=1e-5)
    assert found.world.name == "box"


@pytest.mark.parametrize(
    ("content", "word"),
    [(carmen(cells=b"123"), "ends before"), (carmen(-1), "a grid of"), (b"CARMENMAPFILEv020", "without a grid")],
)
def test_a_bad_carmen_map_is_refused(content: bytes, word: str, tmp_path: Path) -> None:
    (tmp_path / "bad.map").write_bytes(content)
    with pytest.raises(MapFileError, match=word):
        read_map_file(tmp_path / "bad.map")


@pytest.mark.skipif(not DATA.exists(), reason="the maps of real buildings are not beside the project")
@pytest.mark.parametrize(("name", "size_m"), [("nsh_level_3", (67.7, 46.9)), ("wean5300", (65.7, 32.6))])
def test_maps_of_real_buildings(name: str, size_m: tuple[float, float]) -> None:
    found = read_map_file(DATA / f"{name}.map")
    left, bottom, right, top = bounds(found.world)
    assert 0.0 <= left < right <= size_m[0]
    assert 0.0 <= bottom < top <= size_m[1]
    # Corners of straight walls move by less than a cell from those of the cells, corners where two meet a little more.
    assert found.apart_in < 1.0 * IN_PER_M * 0.1
    assert 0.5 * lengths(np.asarray(found.world.walls)).sum() > 100.0 * IN_PER_M
    start = found.world.starts[0]
    assert found.world.clearance(start.x_in, start.y_in) > 1.0 * IN_PER_M


# A rectangle from (100, 100) to (2900, 1900) with y downwards, a line and a circle.
SVG = """<svg xmlns="http://www.w3.org/2000/svg" {size}>
<g transform="translate(100,100)"><rect x="0" y="0" width="2800" height="1800"/></g>
<line x1="1500" y1="100" x2="1500" y2="900"/><circle cx="2200" cy="1200" r="150"/></svg>"""


@pytest.mark.parametrize(
    ("size", "unit_m"),
    # 1 unit is 1 mm; 2 mm; a pixel of 1/96 in.
    [('width="3000mm" height="2000mm" viewBox="0 0 3000 2000"', 0.001), ('width="6m" viewBox="0 0 3000 2000"', 0.002),
     ("", 0.0254 / 96.0)],
)  # fmt: skip
def test_svg_drawing_has_its_unit(size: str, unit_m: float, tmp_path: Path) -> None:
    path = tmp_path / "plan.svg"
    path.write_text(SVG.format(size=size))
    world = read_map_file(path).world
    assert bounds(world) == pytest.approx([100 * unit_m, -1900 * unit_m, 2900 * unit_m, -100 * unit_m], abs=1e-4)


def test_curves_are_within_the_tolerance(tmp_path: Path) -> None:
    path = tmp_path / "plan.svg"
    path.write_text(SVG.format(size='width="3000mm" viewBox="0 0 3000 2000"'))
    for tolerance in (0.05, 0.5):
        world = read_map_file(path, ImportSettings(tolerance_in=tolerance)).world
        # Points of the circle of 150 mm radius: all within the tolerance of a wall.
        angles = np.linspace(0.0, 2.0 * pi, 200)
        circle = (np.array([2200.0, -1200.0]) + 150.0 * np.stack((np.cos(angles), np.sin(angles)), axis=-1)) / 25.4
        assert nearest_points(circle, world.walls)[1].min(axis=1).max() <= tolerance
    path.write_text('<svg xmlns="http://www.w3.org/2000/svg"/>')
    with pytest.raises(MapFileError, match="no lines"):
        read_map_file(path)


def test_start_is_inside_the_drawing(tmp_path: Path) -> None:
    path = tmp_path / "plan.svg"
    path.write_text(SVG.format(size='width="3000mm" viewBox="0 0 3000 2000"'))
    start = read_map_file(path).world.starts[0]
    assert 100 / 25.4 < start.x_in < 2900 / 25.4
    assert -1900 / 25.4 < start.y_in < -100 / 25.4


def dxf(path: Path, unit: str = "M") -> Path:
    import ezdxf
    from ezdxf import units

    drawing = ezdxf.new(units=getattr(units, unit))  # type: ignore[attr-defined]
    model = drawing.modelspace()
    model.add_lwpolyline([(0, 0), (4, 0), (4, 3), (0, 3)], close=True, dxfattribs={"layer": "walls"})
    model.add_circle((3, 2), 0.3)
    post = drawing.blocks.new("post")
    post.add_lwpolyline([(0, 0), (0.2, 0), (0.2, 0.2), (0, 0.2)], close=True)
    model.add_blockref("post", (1, 1), dxfattribs={"rotation": 90})
    model.add_text("a room, 100 m wide", dxfattribs={"height": 50.0})
    drawing.saveas(path)
    return path


def test_dxf_drawing_with_blocks(tmp_path: Path) -> None:
    world = read_map_file(dxf(tmp_path / "plan.dxf")).world
    # The text is no wall.
    assert bounds(world) == pytest.approx([0, 0, 4, 3], abs=1e-5)
    # A corner of the post, turned by its block reference.
    # The post's corner (0.2, 0.2), turned by 90 degrees to (-0.2, 0.2), and moved by (1, 1).
    corner = np.array([[0.8, 1.2]]) * IN_PER_M
    assert nearest_points(corner, world.walls)[1].min() < 1e-3


@pytest.mark.long
def test_dxf_layers_and_units(tmp_path: Path) -> None:
    path = dxf(tmp_path / "plan.dxf", "FT")
    world = read_map_file(path, ImportSettings(layers=("walls",))).world
    assert len(world.walls) == 4
    # 4 x 3 feet.
    assert np.ptp(world.walls.reshape(-1, 2), axis=0) == pytest.approx([48.0, 36.0], abs=1e-3)
    assert np.ptp(read_map_file(path, ImportSettings(unit_in=2.0)).world.walls[:, 0]) == pytest.approx(8.0, abs=1e-3)
    with pytest.raises(MapFileError, match="doors"):
        read_map_file(path, ImportSettings(layers=("doors",)))


def test_missing_library_names_the_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = box_image(tmp_path / "plan.png")
    monkeypatch.setitem(sys.modules, "PIL", None)
    with pytest.raises(MapsExtraMissing, match="maps"):
        read_map_file(path, ImportSettings(cell_in=1.0))


# export and commands


def test_exported_map_is_read_by_other_libraries(tmp_path: Path) -> None:
    image, grid = write_ros_map(load_world("several_walls"), tmp_path / "room.yaml", 0.05 * IN_PER_M)
    values = yaml.safe_load((tmp_path / "room.yaml").read_text())
    assert (values["image"], values["resolution"]) == ("room.pgm", 0.05)
    with Image.open(image) as opened:
        pixels = np.asarray(opened)
    # The array has rows first; the grid has x first.
    assert pixels.shape == grid.cells.shape[::-1]
    # Occupied, unknown and free, as map_server writes them.
    assert set(np.unique(pixels)) == {0, 205, 254}
    # The pixel of a free place, from the lower left corner.
    x, y = (5.0 * 0.0254 - values["origin"][0]) / 0.05, (5.0 * 0.0254 - values["origin"][1]) / 0.05
    assert pixels[pixels.shape[0] - 1 - int(y), int(x)] == 254


@pytest.mark.long
def test_export_and_import_commands(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["map", "export", "flat", "--out", str(tmp_path / "flat.yaml"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["resolution_m"] == 0.05
    words = ["map", "import", str(tmp_path / "flat.yaml"), "--out", str(tmp_path / "flat.toml")]
    assert main([*words, "--picture", str(tmp_path / "flat.png")]) == 0
    assert "walls, at most" in capsys.readouterr().out
    with Image.open(tmp_path / "flat.png") as picture:
        assert picture.width > 100
    world = load_world(tmp_path / "flat.toml")
    assert nearest_points(world.walls.reshape(-1, 2), load_world("flat").walls)[1].min(axis=1).max() < 3.0
    assert main([*words, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["open_in"] == 0.0


def test_commands_report_errors(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["map", "import", str(tmp_path / "absent.map"), "--out", str(tmp_path / "x.toml")]) != 0
    assert "absent.map" in capsys.readouterr().err
    huge = ["map", "export", "hall", "--resolution", "0.0005", "--out", str(tmp_path / "x.yaml")]
    assert main(huge) != 0
    assert "too large" in capsys.readouterr().err
    assert map_command.PROBLEMS_FOUND == 3
