"""Maps of other tools: read ROS, CARMEN, SVG, DXF and bitmaps as worlds, write worlds as ROS maps.

    .yaml .yml               ROS map_server: a PGM or PNG image with resolution, origin and thresholds
    .map .map.gz             CARMEN: probabilities in cells
    .png .pgm .bmp .gif .jpg a bitmap; its scale must be given
    .svg                     lines and curves of a drawing, in its units
    .dxf                     lines, polylines, arcs and splines of a CAD drawing, inside blocks as well

Cells become straight walls (cells.py); curves become straight pieces within the same tolerance. All errors are
MapFileError. The libraries that read the formats are in the extra `maps`.
"""

from __future__ import annotations

import gzip
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from nclient.errors import ExtraMissing, MapFileError, install_command
from worlds.cells import MAX_CELLS, Cell, OccupancyGrid, cells_of_world, roomiest_place, walls_of_cells
from worlds.geometry import FloatArray, area, crossing, lengths, polygon_segments, polyline_segments
from worlds.schema import MIN_WALL_IN
from worlds.world import Point, Polygon, StartPose, World

if TYPE_CHECKING:
    from PIL.Image import Image

IN_PER_M: Final = 1.0 / 0.0254
PX_PER_IN: Final = 96.0
"""Units of an SVG drawing without a size: CSS pixels."""
MAX_FILE_BYTES: Final = 200_000_000
BITMAPS: Final = (".png", ".pgm", ".bmp", ".gif", ".jpg", ".jpeg", ".tif", ".tiff")
DEFAULT_TOLERANCE: Final = 0.9
"""Default tolerance in cells: the end of a wall that is one cell thick keeps its two corners."""
OCCUPIED_THRESH, FREE_THRESH = 0.65, 0.196
"""Default thresholds of ROS's map_server: a cell above the first is occupied, one below the second free."""
_CARMEN_MAGIC: Final = b"CARMENMAPFILEv020"
_CARMEN_GRID: Final = b"GRIDMAP"
# What a wall is drawn with; texts, hatches and dimensions are none.
_DXF_LINES: Final = frozenset({"LINE", "LWPOLYLINE", "POLYLINE", "ARC", "CIRCLE", "ELLIPSE", "SPLINE", "MLINE"})
# Gray levels that map_saver writes.
_GRAY: Final[Mapping[Cell, int]] = MappingProxyType({Cell.FREE: 254, Cell.OCCUPIED: 0, Cell.UNKNOWN: 205})


@dataclass(frozen=True, slots=True)
class ImportSettings:
    """Settings of an import.

    Attributes
    ----------
    tolerance_in
        Largest distance between a wall and the cells or curve it replaces; None for 0.9 cells, or 0.25 in of a drawing.
    cell_in
        Side of a bitmap's pixel in inches; required for bitmaps.
    unit_in
        Inches of one unit of a drawing; None for the unit that the file states.
    min_cells
        Smaller regions of cells are noise.
    close_open_ends
        True to put walls where known space ends without one.
    layers
        Layers of a DXF drawing to read; empty for all.
    """

    tolerance_in: float | None = None
    cell_in: float | None = None
    unit_in: float | None = None
    min_cells: int = 4
    close_open_ends: bool = False
    layers: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class ImportedMap:
    """A world made from a map file, with the figures of its making.

    Attributes
    ----------
    world
    apart_in
        Largest distance between the walls and the cells or curves of the file.
    open_in
        Length of the boundary of known space without a wall.
    """

    world: World
    apart_in: float
    open_in: float


def read_map_file(path: Path, settings: ImportSettings | None = None) -> ImportedMap:
    """Return the world of a map file; its format is decided by the suffix.

    Raises
    ------
    MapFileError
        If the file cannot be read, is not of its format, or has no walls.
    MapsExtraMissing
        If a library of the extra `maps` is not installed.
    """
    settings = settings or ImportSettings()
    name = path.name.lower()
    with _extra_needed(path):
        try:
            if path.stat().st_size > MAX_FILE_BYTES:
                raise MapFileError(f"{path}: larger than {MAX_FILE_BYTES // 1_000_000} MB")
            if name.endswith((".svg", ".dxf")):
                read = _read_svg if name.endswith(".svg") else _read_dxf
                return _drawing(path, *read(path, settings), settings)
            return _cells(path, _read_grid(path, settings), settings)
        except OSError as error:
            raise MapFileError(f"{path}: cannot be read: {error.strerror or error}") from error


@contextmanager
def _extra_needed(path: Path) -> Iterator[None]:
    """Raise MapsExtraMissing where a library is not installed."""
    try:
        yield
    except ModuleNotFoundError as error:
        raise MapsExtraMissing(f"{path}: this needs {error.name}: {install_command('maps')}") from error


class MapsExtraMissing(ExtraMissing):
    """A library of the extra `maps` is required and not installed; the message names it."""


# grids


def _read_grid(path: Path, settings: ImportSettings) -> OccupancyGrid:
    name = path.name.lower()
    if name.endswith((".yaml", ".yml")):
        return _read_ros(path)
    if name.endswith((".map", ".map.gz")):
        return _read_carmen(path)
    if name.endswith(BITMAPS):
        if settings.cell_in is None:
            raise MapFileError(f"{path}: a bitmap has no scale: give the side of a pixel, for example --cell 2 (in)")
        return OccupancyGrid(_classified(_darkness(_image(path))), settings.cell_in)
    raise MapFileError(f"{path}: unknown format; expected .yaml (ROS), .map (CARMEN), .svg, .dxf or a bitmap")


def _classified(probability: FloatArray, occupied: float = OCCUPIED_THRESH, free: float = FREE_THRESH) -> Any:
    """Return the Cells (n, m) of probabilities (n, m) of being occupied; NaN is unknown."""
    cells = np.full(probability.shape, Cell.UNKNOWN, dtype=np.uint8)
    cells[probability > occupied] = Cell.OCCUPIED
    cells[probability < free] = Cell.FREE
    return cells


def _image(path: Path) -> Image:
    from PIL import Image as Pillow
    from PIL import UnidentifiedImageError

    try:
        with Pillow.open(path) as image:
            if image.width * image.height > MAX_CELLS:
                raise MapFileError(f"{path}: {image.width} x {image.height} pixels are too many; at most {MAX_CELLS}")
            return image.convert("LA")
    except (UnidentifiedImageError, Pillow.DecompressionBombError, SyntaxError, ValueError) as error:
        raise MapFileError(f"{path}: not a readable image: {error}") from error


def _darkness(image: Image, *, negate: bool = False) -> FloatArray:
    """Return the darkness (n, m), 0 to 1, of an image's pixels, first index along x, second along y upwards."""
    gray, alpha = np.moveaxis(np.asarray(image, dtype=np.float64), -1, 0) / 255.0
    darkness = np.where(alpha == 0.0, np.nan, gray if negate else 1.0 - gray)
    # Rows of an image run from the top downwards.
    return darkness[::-1].T


def _read_ros(path: Path) -> OccupancyGrid:
    """Return the grid of a map.yaml of ROS's map_server."""
    import yaml

    try:
        values = yaml.safe_load(path.read_text(encoding="utf-8"))
        if not isinstance(values, dict):
            raise MapFileError(f"{path}: expected a map.yaml with image, resolution and origin")
        mode = str(values.get("mode", "trinary"))
        size_in = float(values["resolution"]) * IN_PER_M
        x_m, y_m, turn_rad = (float(value) for value in values.get("origin", (0.0, 0.0, 0.0)))
        occupied, free = (float(values.get(key, default))
                          for key, default in (("occupied_thresh", OCCUPIED_THRESH), ("free_thresh", FREE_THRESH)))
        image_path = path.parent / str(values["image"])
    except (KeyError, TypeError, ValueError, UnicodeDecodeError, yaml.YAMLError) as error:
        what = f"{error.args[0]} is missing" if isinstance(error, KeyError) else str(error)
        raise MapFileError(f"{path}: not a map.yaml of ROS: {what}") from error
    if not (0.0 < size_in < 1e4 and np.isfinite((x_m, y_m, turn_rad)).all()):
        raise MapFileError(f"{path}: resolution and origin must be finite, the resolution above 0")
    if mode not in ("trinary", "scale", "raw"):
        raise MapFileError(f"{path}: mode: expected trinary, scale or raw, found {mode!r}")
    image = _image(image_path)
    probability = _darkness(image, negate=bool(values.get("negate", 0)))
    if mode == "raw":
        # A raw image has the numbers of a nav_msgs/OccupancyGrid: 0 to 100, anything else is unknown.
        percent = np.round(255.0 * _darkness(image, negate=True))
        probability = np.where(percent <= 100.0, percent / 100.0, np.nan)
    origin = (x_m * IN_PER_M, y_m * IN_PER_M)
    return OccupancyGrid(_classified(probability, occupied, free), size_in, origin, turn_rad)


def _read_carmen(path: Path) -> OccupancyGrid:
    """Return the grid of a CARMEN map: a text header, then chunks of type (1 byte), size (4 bytes), name (10 bytes).

    The chunk GRIDMAP has width, height, resolution in m, and one float per cell, y varying fastest: the probability
    that it is occupied, -1 where unknown.
    """
    content = path.read_bytes()
    if content[:2] == b"\x1f\x8b":
        with gzip.open(path) as file:
            content = file.read(MAX_FILE_BYTES)
    at = content.find(_CARMEN_MAGIC)
    if at < 0:
        raise MapFileError(f"{path}: not a CARMEN map: {_CARMEN_MAGIC.decode()} is missing")
    at += len(_CARMEN_MAGIC)
    while at + 15 <= len(content):
        size = int(np.frombuffer(content, "<i4", 1, at + 1)[0])
        body = content[at + 5 : at + 5 + size]
        if body[:10].rstrip() == _CARMEN_GRID and len(body) >= 22:
            width, height = np.frombuffer(body, "<i4", 2, 10).tolist()
            resolution_m = float(np.frombuffer(body, "<f4", 1, 18)[0])
            if not (0 < width * height <= MAX_CELLS and width > 0 and 0.0 < resolution_m < 100.0):
                raise MapFileError(f"{path}: a grid of {width} x {height} cells of {resolution_m:g} m")
            if len(body) < 22 + 4 * width * height:
                raise MapFileError(f"{path}: the file ends before its {width} x {height} cells")
            found = np.frombuffer(body, "<f4", width * height, 22).reshape(width, height).astype(np.float64)
            return OccupancyGrid(_classified(np.where(found < 0.0, np.nan, found)), resolution_m * IN_PER_M)
        at += 5 + max(size, 0)
    raise MapFileError(f"{path}: a CARMEN map without a grid")


def _cells(path: Path, grid: OccupancyGrid, settings: ImportSettings) -> ImportedMap:
    tolerance_in = settings.tolerance_in or DEFAULT_TOLERANCE * grid.size_in
    found = walls_of_cells(grid, tolerance_in, min_cells=settings.min_cells, close_open_ends=settings.close_open_ends)
    lines = [_without_crumbs(line) for line in found.walls]
    start = roomiest_place(grid)
    return ImportedMap(_world(path, lines, start, is_closed=not found.open_in), found.apart_in, found.open_in)


# drawings


def _read_svg(path: Path, settings: ImportSettings) -> tuple[list[FloatArray], float]:
    """Return the lines of an SVG drawing as polylines in inches, y up, and the largest distance from its curves."""
    from svgpathtools import Document  # type: ignore[import-untyped]

    try:
        document = Document(str(path))
        found = document.paths()
        root = document.root
        unit_in = settings.unit_in or _svg_unit_in(root.get("width"), root.get("viewBox"))
    # The library raises whatever its parts raise at a malformed file.
    except Exception as error:
        raise MapFileError(f"{path}: not a readable SVG drawing: {type(error).__name__}: {error}") from error
    tolerance = (settings.tolerance_in or 0.25) / unit_in
    lines = [line for one in found for part in one.continuous_subpaths() for line in _svg_points(part, tolerance)]
    # The y axis of SVG points down.
    return [unit_in * line * (1.0, -1.0) for line in lines], tolerance * unit_in


def _svg_unit_in(width: str | None, view_box: str | None) -> float:
    """Return the inches of one unit of a drawing: its width over the width of its view box."""
    units = {"mm": 1.0 / 25.4, "cm": 1.0 / 2.54, "in": 1.0, "pt": 1.0 / 72.0, "pc": 1.0 / 6.0, "m": IN_PER_M}
    text = (width or "").strip()
    number, unit = text.rstrip("abcdefghijklmnopqrstuvwxyz%"), text.lstrip("0123456789.+-eE ")
    if view_box is None or not number or unit == "%":
        return units.get(unit, 1.0 / PX_PER_IN)
    wide = float(view_box.replace(",", " ").split()[2])
    return float(number) * units.get(unit, 1.0 / PX_PER_IN) / wide


def _svg_points(part: Any, tolerance: float) -> Iterator[FloatArray]:
    """Yield a connected path as a polyline (n, 2); curves are divided until they are within the tolerance."""
    from svgpathtools import Line

    points = [part[0].start]
    for segment in part:
        if not isinstance(segment, Line):
            # A curve divided into n equal parts is nearer to its chords by the factor n^2.
            chord = segment.end - segment.start
            sag = max(abs(segment.point(t) - segment.start - t * chord) for t in (0.25, 0.5, 0.75))
            count = min(200, int(np.ceil(np.sqrt(2.0 * sag / tolerance))) + 1)
            points += [segment.point(k / count) for k in range(1, count)]
        points.append(segment.end)
    yield np.array([(point.real, point.imag) for point in points])


def _read_dxf(path: Path, settings: ImportSettings) -> tuple[list[FloatArray], float]:
    """Return the lines of a DXF drawing as polylines in inches, and the largest distance from its curves."""
    from ezdxf.disassemble import recursive_decompose, to_primitives
    from ezdxf.enums import InsertUnits
    from ezdxf.filemanagement import readfile
    from ezdxf.lldxf.const import DXFError
    from ezdxf.units import conversion_factor

    try:
        drawing = readfile(path)
    except (DXFError, UnicodeDecodeError, ValueError) as error:
        raise MapFileError(f"{path}: not a readable DXF drawing: {error}") from error
    stated = InsertUnits(drawing.units)
    unit_in = settings.unit_in or (conversion_factor(stated, InsertUnits.Inches) if stated else 1.0)
    tolerance = (settings.tolerance_in or 0.25) / unit_in
    entities = (entity for entity in recursive_decompose(drawing.modelspace()) if entity.dxftype() in _DXF_LINES
                and (not settings.layers or entity.dxf.layer in settings.layers))
    lines = []
    for primitive in to_primitives(entities, max_flattening_distance=tolerance):
        if primitive.path is not None:
            for part in primitive.path.sub_paths() if primitive.path.has_sub_paths else (primitive.path,):
                lines.append(np.array([(point.x, point.y) for point in part.flattening(tolerance)]))
    return [unit_in * line for line in lines], tolerance * unit_in


def _drawing(path: Path, lines: Sequence[FloatArray], apart_in: float, settings: ImportSettings) -> ImportedMap:
    cleaned = [_without_crumbs(line) for line in lines]
    if not any(len(line) >= 2 for line in cleaned):
        hint = f" on the layers {', '.join(settings.layers)}" if settings.layers else ""
        raise MapFileError(f"{path}: no lines{hint}")
    # A place in the drawing: of cells a five-hundredth of it, those that its lines enclose.
    inner = np.concatenate([polyline_segments(line) for line in cleaned if len(line) >= 2])
    size = max(float(np.ptp(inner.reshape(-1, 2), axis=0).max()) / 500.0, 0.1)
    grid = cells_of_world(World(path.stem, inner_walls=inner, starts=()), size)
    return ImportedMap(_world(path, cleaned, roomiest_place(grid), is_closed=False), apart_in, 0.0)


# worlds


def _without_crumbs(line: FloatArray) -> FloatArray:
    """Return a polyline, rounded to 0.0001 in, without points that repeat the one before."""
    line = np.round(line, 4) + 0.0
    long_enough = np.concatenate(([True], lengths(polyline_segments(line)) >= MIN_WALL_IN))
    return line[long_enough]


def _world(path: Path, lines: Iterable[FloatArray], start: Point, *, is_closed: bool) -> World:
    """Return a world of polylines; where all boundaries are closed, outer ones are rooms, so that inside is known."""
    rooms, inner = [], [np.empty((0, 4))]
    for line in lines:
        corners = tuple((float(x), float(y)) for x, y in line[:-1])
        is_room = is_closed and len(corners) >= 3 and area(corners) > 0.0 and not crossing(polygon_segments(corners))
        if is_room:
            rooms.append(Polygon(corners))
        elif len(line) >= 2:
            inner.append(polyline_segments(line))
    walls = np.concatenate(inner)
    if not rooms and not len(walls):
        raise MapFileError(f"{path}: no walls: nothing is both free and bounded by occupied cells")
    pose = StartPose(round(start[0], 2), round(start[1], 2))
    return World(path.stem.split(".")[0], f"from {path.name}", tuple(rooms), walls, starts=(pose,))


def write_ros_map(world: World, path: Path, size_in: float) -> tuple[Path, OccupancyGrid]:
    """Write a world as map.yaml and PGM beside it; return the path of the image, and the grid.

    Raises
    ------
    MapFileError
        If the grid would be too large.
    OSError
        If a file cannot be written.
    """
    try:
        with _extra_needed(path):
            grid = cells_of_world(world, size_in)
    except ValueError as error:
        raise MapFileError(f"{world.name}: {error}") from error
    levels = np.array([_GRAY[cell] for cell in Cell], dtype=np.uint8)
    width, height = grid.cells.shape
    image = path.with_suffix(".pgm")
    # Rows of an image run from the top downwards.
    image.write_bytes(f"P5\n{width} {height}\n255\n".encode() + levels[grid.cells.T[::-1]].tobytes())
    x_m, y_m = (value / IN_PER_M for value in grid.origin_in)
    path.write_text(
        f"image: {image.name}\nmode: trinary\nresolution: {size_in / IN_PER_M:.9g}\norigin: [{x_m:.9g}, {y_m:.9g}, 0]\n"
        f"negate: 0\noccupied_thresh: {OCCUPIED_THRESH}\nfree_thresh: {FREE_THRESH}\n",
        encoding="utf-8",
    )
    return image, grid
