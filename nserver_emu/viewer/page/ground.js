// What can be said of a world without asking: what is inside what, and whether corners make an obstacle. Pure.

export const MOST_CORNERS = 10;

export function inside(corners, x, y) {
  let within = false;
  for (let i = 0, j = corners.length - 1; i < corners.length; j = i, i += 1) {
    const [xi, yi] = corners[i], [xj, yj] = corners[j];
    if (yi > y !== yj > y && x < (xj - xi) * (y - yi) / (yj - yi) + xi) within = !within;
  }
  return within;
}

// Whether a point is in a room (where there are any) and in no obstacle.
export function isFree(world, x, y) {
  if (!world) return true;
  const roomed = !world.rooms.length || world.rooms.some((room) => inside(room.corners, x, y));
  return roomed && !world.obstacles.some((thing) => inside(thing.corners, x, y));
}

// What is wrong with the corners of an obstacle, in words; nothing where they are right.
export function cornersWrong(corners) {
  if (corners.length < 3 || corners.length > MOST_CORNERS) {
    return `an obstacle has 3 to ${MOST_CORNERS} corners, not ${corners.length}`;
  }
  const sides = corners.map((corner, k) => [corner, corners[(k + 1) % corners.length]]);
  for (let i = 0; i < sides.length; i += 1) {
    for (let j = i + 2; j < sides.length; j += 1) {
      if ((i > 0 || j < sides.length - 1) && cross(sides[i], sides[j])) return 'the sides of an obstacle may not cross each other';
    }
  }
  const twice = sides.reduce((sum, [[x1, y1], [x2, y2]]) => sum + x1 * y2 - x2 * y1, 0);
  return Math.abs(twice) < 1e-6 ? 'the corners of an obstacle may not all lie on one line' : '';
}

function cross([[ax, ay], [bx, by]], [[cx, cy], [dx, dy]]) {
  const side = (px, py, qx, qy, rx, ry) => Math.sign((qx - px) * (ry - py) - (qy - py) * (rx - px));
  return side(ax, ay, bx, by, cx, cy) !== side(ax, ay, bx, by, dx, dy) && side(cx, cy, dx, dy, ax, ay) !== side(cx, cy, dx, dy, bx, by);
}
