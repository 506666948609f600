"""The first echo of a ping: paths of sound from transducer to transducer, in plain numbers.

Smooth walls reflect sound like mirrors, so all paths off them follow from images of the source:

    off one wall           source' -> receiver                 perpendicular, or to a neighbour that listens
    off two walls          source'' -> receiver                a square corner sends everything back: its vertex
    off one, back off two  source' -> foot on the second       over a slanted wall: too long a range
    off an edge            wall ends and vertices scatter      weakly, in all directions

Other robots are discs:

    specular reflection    one point of the disc reflects from source to receiver; the curvature spreads the sound
    scattering             bumpers, sonars and edges scatter weakly in all directions: a robot that only reaches into
                           the cone is detected at its nearest point there that is loud enough
    off a wall, back off the disc      over a slanted wall

Each path leaves and arrives inside the cones; it has a level, and the points between which it must be free. The first
free one that is loud enough is the echo. The ping of another sonar of the ring that is still in flight is detected like
the sonar's own, and gives too short a range (cross-talk). Not modelled: side lobes, paths off three walls and more or
off two robots, later pings, pings of other robots. The surface of a wall may have levels and posts (acoustics.py).

numba compiles these functions unchanged (acoustics.py). Rows of numbers are lists in plain Python and arrays in
compiled code; only operations that give the same bits in both are used. Empty lists are written as comprehensions that
name the type of what they will contain, which numba needs.

References
----------
Kuc and Siegel, Physically based simulation model for acoustic sensor robot navigation, IEEE PAMI 9 (1987): walls as
mirrors, edges as scatterers, the beam's directivity.
"""

from math import asin, atan2, cos, inf, log10, sin, sqrt, tan
from typing import Any, Final, NamedTuple

from nserver_emu.simulation import visibility
from nserver_emu.simulation.visibility import TINY, Beam, Reflectors, Wall, blocks_between, distance, walls_in_cone
from worlds.raycast import nearest_wall, ray_to_disc, sort_by_range

SMALL_IN: Final = 1e-6
"""Offset of the start of a reflected leg from its wall, and tolerance at its end: inches, a millionth of the resolution
of a reading."""

STRAIGHT_RAD: Final = 1e-3
"""Two walls that meet within this of a straight line are one wall, and have no edge there."""

SCATTERERS: Final = 33
"""Scattering points of a robot, evenly over its visible part: at most 0.8 degrees apart, a third of an inch of range at
60 in, where a hundredth of the range is noise."""

BISECTIONS: Final = 48
"""Of the arc between the points that face two transducers: the rest is far below SMALL_IN."""


class Attenuation(NamedTuple):
    """Cones and losses.

    Half angle of the cones and one-way loss at the rim; loss per inch of range, at each wall after the first, at an
    edge, by scattering at a robot, and at a post.
    """

    half_rad: float
    rim_loss_db: float
    absorption_db_in: float
    bounce_loss_db: float
    edge_loss_db: float
    skin_loss_db: float
    post_loss_db: float


class Pair(NamedTuple):
    """A transmitting and a receiving beam, and which of their echoes are detected.

    Attributes
    ----------
    is_own
        True for a sonar that receives its own ping.
    offset_in
        Range of a path of length 0: less the depth of the transducer, and half of the distance that an earlier ping has
        travelled when the receiver starts to measure.
    min_range_in, margin_db
        Shortest range and largest loss of an echo that is detected.
    losses
        Cones and losses of both.
    """

    out: Beam
    back: Beam
    is_own: bool
    offset_in: float
    min_range_in: float
    margin_db: float
    losses: Attenuation


class Mirror(NamedTuple):
    """A wall in a cone: first end, vector to the second, unit direction squared, distance from the apex, number."""

    x: float
    y: float
    along_x: float
    along_y: float
    twist_x: float
    twist_y: float
    distance_in: float
    row: int


def first_echo(sources: Any, margin_db: float, min_range_in: float, recess_in: float, losses: Attenuation,
               reflectors: Reflectors, discs: Any, max_range_in: float) -> float:
    """Return the range of the first echo that a sonar detects; inf for none below `max_range_in`.

    Parameters
    ----------
    sources
        The ping of the sonar, then earlier ones in flight: rows of position and direction of the transducer, and the
        distance that the sound has travelled when the sonar fires, inches.
    margin_db
        Largest loss of an echo that is detected.
    min_range_in
        Shortest range of the echo of an earlier ping.
    recess_in
        Depth of the transducers.
    discs
        The other robots: columns x, y, radius.
    """
    nearest_in, slope = max_range_in, tan(losses.half_rad)
    back = Beam(sources[0][0], sources[0][1], cos(sources[0][2]), sin(sources[0][2]))
    # 1. The walls in the receiver's cone that sound reaches on half of its path.
    loudest_in = margin_db / losses.absorption_db_in if losses.absorption_db_in > 0.0 else inf
    farthest_in = 0.0
    for source in sources:
        half_in = min(loudest_in, nearest_in + recess_in + source[3] / 2.0)
        farthest_in = max(farthest_in, half_in + distance(source[0], source[1], back.x, back.y) / 2.0)
    back_rows, back_walls = walls_in_cone(back, slope, farthest_in, reflectors)
    lasts = mirrors_of(back, back_rows, back_walls)
    for number in range(len(sources)):
        # 2. The pair. Its paths are at most so long that sound is loud enough, and the echo nearer than one found.
        source, is_own = sources[number], number == 0
        out, offset_in = Beam(source[0], source[1], cos(source[2]), sin(source[2])), -recess_in - source[3] / 2.0
        pair = Pair(out, back, is_own, offset_in, -inf if is_own else min_range_in, margin_db, losses)
        reach_in = min(loudest_in, nearest_in - offset_in) + distance(out.x, out.y, back.x, back.y) / 2.0
        if min(loudest_in, nearest_in - offset_in) < 0.0:
            continue
        out_rows, out_walls = (back_rows, back_walls) if is_own else walls_in_cone(out, slope, reach_in, reflectors)
        firsts = lasts if is_own else mirrors_of(out, out_rows, out_walls)
        # 3. The shortest free path off one reflector ...
        echoes = off_walls(pair, nearest_in, firsts, reflectors)
        off_edges(echoes, pair, nearest_in, out_walls)
        off_posts(echoes, pair, nearest_in, reflectors.posts)
        for disc in zip(discs[0], discs[1], discs[2]):  # noqa: B905  for numba
            off_disc(echoes, pair, nearest_in, disc)
            if is_own:
                over_walls_to_disc(echoes, pair, nearest_in, firsts, disc)
        nearest_in = first_free(echoes, pair, nearest_in, out_walls, back_walls, reflectors, discs)
        # 4. ... and of those off two walls that are shorter.
        reach_in = min(loudest_in, nearest_in - offset_in) + distance(out.x, out.y, back.x, back.y) / 2.0
        firsts = mirrors_within(firsts, reach_in)
        echoes = off_two_walls(pair, nearest_in, firsts, mirrors_within(lasts, reach_in))
        if is_own:
            over_walls_to_walls(echoes, pair, nearest_in, firsts, reflectors)
        nearest_in = first_free(echoes, pair, nearest_in, out_walls, back_walls, reflectors, discs)
    return nearest_in if nearest_in < max_range_in else inf


# Geometry


def mirrored(x: float, y: float, mirror: Mirror) -> tuple[float, float]:
    """Return the image of a point: a + u^2 conj(p - a) in complex numbers, with a point a and the direction u."""
    to_x, to_y = x - mirror.x, y - mirror.y
    return (
        mirror.x + (mirror.twist_x * to_x + mirror.twist_y * to_y),
        mirror.y + (mirror.twist_y * to_x - mirror.twist_x * to_y),
    )


def crossing(x: float, y: float, to_x: float, to_y: float, mirror: Mirror) -> tuple[bool, float, float]:
    """Return True if the line from (x, y) to (to_x, to_y) crosses a mirror, and where (by Cramer's rule)."""
    line_x, line_y, offset_x, offset_y = to_x - x, to_y - y, mirror.x - x, mirror.y - y
    turned = line_x * mirror.along_y - line_y * mirror.along_x
    if turned == 0.0:  # parallel lines do not cross
        return False, x, y
    on_line = (offset_x * mirror.along_y - offset_y * mirror.along_x) / turned
    on_wall = (offset_x * line_y - offset_y * line_x) / turned
    is_met = 0.0 < on_line <= 1.0 + TINY and -TINY <= on_wall <= 1.0 + TINY
    return is_met, x + on_line * line_x, y + on_line * line_y


def wall_distance(beam: Beam, wall: Wall) -> float:
    """Return the distance of the nearest point of a wall from the apex."""
    along_x, along_y, to_x, to_y = wall[2] - wall[0], wall[3] - wall[1], beam.x - wall[0], beam.y - wall[1]
    square = along_x * along_x + along_y * along_y
    fraction = min(max((to_x * along_x + to_y * along_y) / square, 0.0), 1.0) if square > 0.0 else 0.0
    return distance(to_x, to_y, fraction * along_x, fraction * along_y)


def mirrors_of(beam: Beam, rows: list[int], walls: list[Wall]) -> list[Mirror]:
    """Return the walls that have a length as mirrors."""
    mirrors = [Mirror(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0) for _ in range(0)]
    for row, wall in zip(rows, walls):  # noqa: B905  for numba
        along_x, along_y = wall[2] - wall[0], wall[3] - wall[1]
        square = along_x * along_x + along_y * along_y
        if square > 0.0:
            twist_x, twist_y = (along_x * along_x - along_y * along_y) / square, 2.0 * along_x * along_y / square
            away = wall_distance(beam, wall)
            mirrors.append(Mirror(wall[0], wall[1], along_x, along_y, twist_x, twist_y, away, row))
    return mirrors


def mirrors_within(mirrors: list[Mirror], reach_in: float) -> list[Mirror]:
    """Return the mirrors that sound from the apex reaches."""
    return [mirror for mirror in mirrors if mirror.distance_in <= reach_in]


# Levels


def beam_loss_db(beam: Beam, losses: Attenuation, x: float, y: float) -> float:
    """Return the one-way loss towards a point, which grows with the angle squared; inf outside the cone."""
    ahead, left = visibility.in_frame(beam, x, y)
    off_axis = abs(atan2(left, ahead)) / losses.half_rad
    return losses.rim_loss_db * off_axis * off_axis if off_axis <= 1.0 else inf


def point_loss_db(pair: Pair, x: float, y: float) -> float:
    """Return the loss towards a point and back from it; inf outside one of the cones."""
    out_db = beam_loss_db(pair.out, pair.losses, x, y)
    return 2.0 * out_db if pair.is_own else out_db + beam_loss_db(pair.back, pair.losses, x, y)


def echo_range(pair: Pair, length_in: float, loss_db: float) -> float:
    """Return the range that a path of this length gives, with this loss besides absorption; inf if not detected."""
    range_in = length_in / 2.0 + pair.offset_in
    is_detected = loss_db + pair.losses.absorption_db_in * length_in / 2.0 <= pair.margin_db
    return range_in if is_detected and range_in >= pair.min_range_in else inf


def level_in(row: int, along_in: float, reflectors: Reflectors) -> float:
    """Return how far the surface of a wall stands out to its left, at a distance from its first end."""
    low, high = reflectors.begins[row], reflectors.begins[row + 1]
    while low < high:
        middle = (low + high) // 2
        if reflectors.breaks_in[middle] <= along_in:
            low = middle + 1
        else:
            high = middle
    return float(reflectors.levels_in[low - 1])


# Paths off one reflector. An echo is its range, the points of two reflections (of one: twice), and the end of the path.

Echo = tuple[float, float, float, float, float, float, float]


def add_echo(echoes: list[Echo], nearest_in: float, range_in: float,
             path: tuple[float, float, float, float, float, float]) -> None:
    """Add the echo of a path if it is nearer than one found."""
    if range_in < nearest_in:
        echoes.append((range_in, *path))


def off_walls(pair: Pair, nearest_in: float, mirrors: list[Mirror], reflectors: Reflectors) -> list[Echo]:
    """Return the echoes off one wall."""
    out, back = pair.out, pair.back
    echoes = [(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0) for _ in range(0)]
    for mirror in mirrors:
        image_x, image_y = mirrored(out.x, out.y, mirror)
        is_met, x, y = crossing(image_x, image_y, back.x, back.y, mirror)
        if is_met:
            length_in = distance(image_x, image_y, back.x, back.y)
            if len(reflectors.begins):
                # The surface stands out to one side of the wall: towards the receiver or away from it.
                left = mirror.along_x * (back.y - mirror.y) - mirror.along_y * (back.x - mirror.x)
                side = 1.0 if left > 0.0 else -1.0 if left < 0.0 else 0.0
                out_in = side * level_in(mirror.row, distance(mirror.x, mirror.y, x, y), reflectors)
                length_in = max(length_in - 2.0 * out_in, 0.0)
            range_in = echo_range(pair, length_in, point_loss_db(pair, x, y))
            add_echo(echoes, nearest_in, range_in, (x, y, x, y, back.x, back.y))
    return echoes


def off_edges(echoes: list[Echo], pair: Pair, nearest_in: float, walls: list[Wall]) -> None:
    """Add the echoes off ends and vertices of walls in the cone, except where a wall continues straight."""
    end_x, end_y = inf, inf
    for x1, y1, x2, y2 in walls:
        if x1 == x2 and y1 == y2:
            continue
        # Most walls begin where the one before ends.
        if x1 != end_x or y1 != end_y:
            off_edge(echoes, pair, nearest_in, x1, y1, walls)
        off_edge(echoes, pair, nearest_in, x2, y2, walls)
        end_x, end_y = x2, y2


def off_edge(echoes: list[Echo], pair: Pair, nearest_in: float, x: float, y: float, walls: list[Wall]) -> None:
    """Add the echo off an end of a wall."""
    range_in = scattered_range(pair, nearest_in, x, y, 0.0, 0.0, pair.losses.edge_loss_db)
    if range_in < nearest_in and is_edge(x, y, walls):
        echoes.append((range_in, x, y, x, y, pair.back.x, pair.back.y))


def off_posts(echoes: list[Echo], pair: Pair, nearest_in: float, posts: Any) -> None:
    """Add the echoes off posts. A displaced post counts as on its wall for all but the length of the path."""
    for x, y, shift_x, shift_y in zip(posts[0], posts[1], posts[2], posts[3]):  # noqa: B905  for numba
        range_in = scattered_range(pair, nearest_in, x, y, shift_x, shift_y, pair.losses.post_loss_db)
        add_echo(echoes, nearest_in, range_in, (x, y, x, y, pair.back.x, pair.back.y))


def scattered_range(pair: Pair, nearest_in: float, x: float, y: float, shift_x: float,
                    shift_y: float, loss_db: float) -> float:
    """Return the range of a point that scatters, displaced; inf if it is not detected or not nearer than another."""
    out, back, at_x, at_y = pair.out, pair.back, x + shift_x, y + shift_y
    length_in = distance(out.x, out.y, at_x, at_y) + distance(back.x, back.y, at_x, at_y)
    if not pair.min_range_in <= length_in / 2.0 + pair.offset_in < nearest_in:
        return inf
    return echo_range(pair, length_in, point_loss_db(pair, x, y) + loss_db)


def is_edge(x: float, y: float, walls: list[Wall]) -> bool:
    """Return False if exactly two walls end at a point, one the continuation of the other."""
    count, one_x, one_y, two_x, two_y = 0, 0.0, 0.0, 0.0, 0.0
    for x1, y1, x2, y2 in walls:
        if (x1 == x and y1 == y) != (x2 == x and y2 == y):
            count += 1
            one_x, one_y = two_x, two_y
            two_x, two_y = (x2 - x, y2 - y) if x1 == x and y1 == y else (x1 - x, y1 - y)
    turn = atan2(one_x * two_y - one_y * two_x, -(one_x * two_x + one_y * two_y))
    return count != 2 or abs(turn) >= STRAIGHT_RAD


# Paths off another robot


def off_disc(echoes: list[Echo], pair: Pair, nearest_in: float, disc: tuple[float, float, float]) -> None:
    """Add the specular echo of a disc, and those scattered by it.

    A bundle of rays in the plane that a disc of radius r reflects is spread by 1 + 2 a b / ((a + b) r cos(incidence)),
    with the distances a and b before and after; from the same place (a = b = d) by (r + d) / r.
    """
    out, back, losses, (centre_x, centre_y, radius) = pair.out, pair.back, pair.losses, disc
    if not (may_meet_disc(out, losses, disc) and (pair.is_own or may_meet_disc(back, losses, disc))):
        return
    # 1. The point that reflects from one transducer to the other.
    is_outside, normal_x, normal_y = specular_normal(pair, disc)
    if is_outside:
        x, y = centre_x + radius * normal_x, centre_y + radius * normal_y
        before, after = distance(out.x, out.y, x, y), distance(back.x, back.y, x, y)
        cos_incidence = ((out.x - x) * normal_x + (out.y - y) * normal_y) / before
        spread_db = 10.0 * log10(1.0 + 2.0 * before * after / ((before + after) * radius * cos_incidence))
        range_in = echo_range(pair, before + after, point_loss_db(pair, x, y) + spread_db)
        add_echo(echoes, nearest_in, range_in, (x, y, x, y, back.x, back.y))
    # 2. The interval of directions in which the disc is visible inside the cone.
    ahead, left = visibility.in_frame(out, centre_x, centre_y)
    away = distance(0.0, 0.0, ahead, left)
    if away <= radius or losses.skin_loss_db == inf:
        return
    bearing, half = atan2(left, ahead), asin(radius / away)
    low, high = max(bearing - half, -losses.half_rad), min(bearing + half, losses.half_rad)
    if low > high:
        return
    # 3. The points of the rim on evenly spread rays.
    for number in range(SCATTERERS):
        turned = high if number == SCATTERERS - 1 else low + number * ((high - low) / (SCATTERERS - 1))
        to_side = away * sin(turned - bearing)
        there_in = away * cos(turned - bearing) - sqrt(max(radius * radius - to_side * to_side, 0.0))
        cosine, sine = cos(turned), sin(turned)
        x = out.x + there_in * (out.dx * cosine - out.dy * sine)
        y = out.y + there_in * (out.dx * sine + out.dy * cosine)
        out_db = losses.rim_loss_db * (turned / losses.half_rad) * (turned / losses.half_rad)
        loss_db = 2.0 * out_db if pair.is_own else out_db + beam_loss_db(back, losses, x, y)
        length_in = there_in + distance(back.x, back.y, x, y)
        range_in = echo_range(pair, length_in, loss_db + losses.skin_loss_db)
        add_echo(echoes, nearest_in, range_in, (x, y, x, y, back.x, back.y))


def may_meet_disc(beam: Beam, losses: Attenuation, disc: tuple[float, float, float]) -> bool:
    """Return True if a disc reaches into the cone, or nearly: not beyond a side, not behind."""
    ahead, left = visibility.in_frame(beam, disc[0], disc[1])
    return abs(left) * cos(losses.half_rad) - ahead * sin(losses.half_rad) <= disc[2] and ahead >= -disc[2]


def specular_normal(pair: Pair, disc: tuple[float, float, float]) -> tuple[bool, float, float]:
    """Return the unit normal of a disc where it reflects from one transducer to the other; False from inside.

    It lies between the directions to both. There the angles of incidence and of reflection change places in size, so
    the arc is bisected until they are equal.
    """
    x, y, radius = disc
    start_x, start_y, end_x, end_y = pair.out.x - x, pair.out.y - y, pair.back.x - x, pair.back.y - y
    if min(distance(0.0, 0.0, start_x, start_y), distance(0.0, 0.0, end_x, end_y)) <= radius:
        return False, 0.0, 0.0
    first = atan2(start_y, start_x)
    arc = atan2(start_x * end_y - start_y * end_x, start_x * end_x + start_y * end_y)
    low, high = 0.0, 1.0
    for _ in range(0 if pair.is_own else BISECTIONS):
        half = 0.5 * (low + high)
        dx, dy = cos(first + arc * half), sin(first + arc * half)
        incidence = abs(atan2(dx * start_y - dy * start_x, start_x * dx + start_y * dy - radius))
        reflection = abs(atan2(dx * end_y - dy * end_x, end_x * dx + end_y * dy - radius))
        low, high = (half, high) if incidence < reflection else (low, half)
    dx, dy = cos(first + arc * low), sin(first + arc * low)
    return start_x * dx + start_y * dy > radius, dx, dy


def over_walls_to_disc(echoes: list[Echo], pair: Pair, nearest_in: float, mirrors: list[Mirror],
                       disc: tuple[float, float, float]) -> None:
    """Add the echoes off a slanted wall, perpendicularly onto a disc, and back along themselves."""
    out, (centre_x, centre_y, radius) = pair.out, disc
    for mirror in mirrors:
        # 1. The point of the disc that faces the image.
        image_x, image_y = mirrored(out.x, out.y, mirror)
        away = distance(image_x, image_y, centre_x, centre_y)
        if away <= radius:
            continue
        fraction = 1.0 - radius / away
        foot_x, foot_y = image_x + fraction * (centre_x - image_x), image_y + fraction * (centre_y - image_y)
        # 2. The point on the wall; losses there and back, and the spread by the curvature.
        is_met, x, y = crossing(image_x, image_y, foot_x, foot_y, mirror)
        if is_met:
            gap_in = fraction * away
            loss_db = point_loss_db(pair, x, y) + 2.0 * pair.losses.bounce_loss_db
            range_in = echo_range(pair, 2.0 * gap_in, loss_db + 10.0 * log10(1.0 + gap_in / radius))
            add_echo(echoes, nearest_in, range_in, (x, y, foot_x, foot_y, foot_x, foot_y))


# Paths off two walls


def off_two_walls(pair: Pair, nearest_in: float, firsts: list[Mirror], lasts: list[Mirror]) -> list[Echo]:
    """Return the echoes off two walls."""
    out, back, losses = pair.out, pair.back, pair.losses
    echoes = [(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0) for _ in range(0)]
    for one in firsts:
        image_x, image_y = mirrored(out.x, out.y, one)
        for two in lasts:
            # 1. The image in the first wall, and its image in the last: at the length of the path.
            twice_x, twice_y = mirrored(image_x, image_y, two)
            length_in = distance(twice_x, twice_y, back.x, back.y)
            if not pair.min_range_in <= length_in / 2.0 + pair.offset_in < nearest_in:
                continue
            # 2. Backwards from the receiver: the point on the last wall, then the one on the first.
            is_met, x2, y2 = crossing(twice_x, twice_y, back.x, back.y, two)
            if not is_met:
                continue
            is_met, x1, y1 = crossing(image_x, image_y, x2, y2, one)
            if not is_met:
                continue
            loss_db = beam_loss_db(out, losses, x1, y1) + beam_loss_db(back, losses, x2, y2) + losses.bounce_loss_db
            add_echo(echoes, nearest_in, echo_range(pair, length_in, loss_db), (x1, y1, x2, y2, back.x, back.y))
    return echoes


def over_walls_to_walls(echoes: list[Echo], pair: Pair, nearest_in: float, mirrors: list[Mirror],
                        reflectors: Reflectors) -> None:
    """Add the echoes off a slanted wall, perpendicularly onto another, and back along themselves."""
    out, reach_in, has_surfaces = pair.out, nearest_in - pair.offset_in, len(reflectors.begins) > 0
    for mirror in mirrors:
        # 1. The walls that the image sees through the mirror.
        image_x, image_y = mirrored(out.x, out.y, mirror)
        right_x, right_y = mirror.x - TINY * mirror.along_x - image_x, mirror.y - TINY * mirror.along_y - image_y
        left_x, left_y = right_x + (1.0 + 2.0 * TINY) * mirror.along_x, right_y + (1.0 + 2.0 * TINY) * mirror.along_y
        if right_x * left_y < right_y * left_x:
            right_x, right_y, left_x, left_y = left_x, left_y, right_x, right_y
        behind = blocks_between(image_x, image_y, right_x, right_y, left_x, left_y, reach_in, reflectors.boxes)
        for row, (x1, y1, x2, y2) in visibility.walls_of(behind, reflectors.walls):
            # 2. The foot of the perpendicular from the image, in reach.
            along_x, along_y, to_x, to_y = x2 - x1, y2 - y1, image_x - x1, image_y - y1
            square, dot = along_x * along_x + along_y * along_y, to_x * along_x + to_y * along_y
            cross = along_x * to_y - along_y * to_x
            if dot < 0.0 or dot > square or square == 0.0 or cross * cross > reach_in * reach_in * square:
                continue
            # With surfaces the same wall again is the path off one wall, without its level.
            if has_surfaces and row == mirror.row:
                continue
            foot_x, foot_y = x1 + dot / square * along_x, y1 + dot / square * along_y
            # 3. The point on the slanted wall; there and back.
            is_met, x, y = crossing(image_x, image_y, foot_x, foot_y, mirror)
            if is_met:
                length_in = 2.0 * distance(image_x, image_y, foot_x, foot_y)
                loss_db = point_loss_db(pair, x, y) + 2.0 * pair.losses.bounce_loss_db
                range_in = echo_range(pair, length_in, loss_db)
                add_echo(echoes, nearest_in, range_in, (x, y, foot_x, foot_y, foot_x, foot_y))


# Obstructions


def first_free(echoes: list[Echo], pair: Pair, nearest_in: float, out_walls: list[Wall], back_walls: list[Wall],
               reflectors: Reflectors, discs: Any) -> float:
    """Return the shortest range of a path on which nothing stands between one point and the next, or `nearest_in`.

    The first and the last leg of a path lie in the cones, so only the visible walls there can stand between their ends.
    """
    out = pair.out
    sort_by_range(echoes)
    for range_in, x1, y1, x2, y2, end_x, end_y in echoes:
        if (
            is_free(out.x, out.y, x1, y1, out_walls, discs)
            and is_free(x2, y2, end_x, end_y, back_walls, discs)
            and is_free_between(x1, y1, x2, y2, reflectors, discs)
        ):
            return range_in
    return nearest_in


def is_free_between(x: float, y: float, to_x: float, to_y: float, reflectors: Reflectors, discs: Any) -> bool:
    """Return True if no wall at all and no disc stands between two points."""
    if x == to_x and y == to_y:
        return True
    dx, dy, reach_in = to_x - x, to_y - y, distance(x, y, to_x, to_y)
    blocks = blocks_between(x, y, dx, dy, dx, dy, reach_in, reflectors.boxes)
    walls = [wall for _, wall in visibility.walls_of(blocks, reflectors.walls)]
    return is_free(x, y, to_x, to_y, walls, discs)


def is_free(x: float, y: float, to_x: float, to_y: float, walls: list[Wall], discs: Any) -> bool:
    """Return True if no wall and no disc stands between two points; points next to each other see each other."""
    length_in = distance(x, y, to_x, to_y)
    if length_in <= 3.0 * SMALL_IN:
        return True
    dx, dy = (to_x - x) / length_in, (to_y - y) / length_in
    start_x, start_y, end_in = x + SMALL_IN * dx, y + SMALL_IN * dy, length_in - 3.0 * SMALL_IN
    if nearest_wall(start_x, start_y, dx, dy, walls)[0] < end_in:
        return False
    for disc in zip(discs[0], discs[1], discs[2]):  # noqa: B905, SIM110  for numba
        if ray_to_disc(start_x, start_y, dx, dy, disc) < end_in:
            return False
    return True
