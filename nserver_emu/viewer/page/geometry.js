// Geometry without drawing: the transform between world (inches, y up) and screen (CSS pixels, y down), and polygons.

export const MAX_CORNERS = 10;
const MIN_SCALE = 0.02, MAX_SCALE = 400;  // pixels per inch

// View

export function newView() { return { x: 0, y: 0, scale: 4, width: 100, height: 100 }; }

export function toScreen(view, x, y) {
  return [view.width / 2 + (x - view.x) * view.scale, view.height / 2 - (y - view.y) * view.scale];
}

export function toWorld(view, px, py) {
  return [view.x + (px - view.width / 2) / view.scale, view.y - (py - view.height / 2) / view.scale];
}

// Zoom so that the world point under the given pixel stays under it.
export function zoomAt(view, factor, px, py) {
  const [x, y] = toWorld(view, px, py);
  view.scale = Math.min(Math.max(view.scale * factor, MIN_SCALE), MAX_SCALE);
  const [x2, y2] = toWorld(view, px, py);
  view.x += x - x2;
  view.y += y - y2;
}

export function pan(view, dx, dy) { view.x -= dx / view.scale; view.y += dy / view.scale; }

// Center the view on a bounding box and show all of it.
export function fitTo(view, [x1, y1, x2, y2]) {
  const margin = 24, ruler = 14;  // space for the scale bar at the bottom
  const across = (view.width - 2 * margin) / Math.max(x2 - x1, 1);
  const up = (view.height - 2 * margin - ruler) / Math.max(y2 - y1, 1);
  view.scale = Math.max(Math.min(across, up), MIN_SCALE);
  view.x = (x1 + x2) / 2;
  view.y = (y1 + y2) / 2 - ruler / 2 / view.scale;
}

// Return the smallest length of at least minPx pixels that is 1, 2 or 5 times a power of ten of the unit, in inches.
export function roundLength(scale, minPx, unitIn) {
  const shortest = minPx / (scale * unitIn);
  const power = 10 ** Math.floor(Math.log10(shortest));
  // The factor allows for rounding errors of log10 at exact powers of ten.
  return [1, 2, 5, 10].map((k) => k * power).find((length) => length >= shortest * 0.999999) * unitIn;
}

// Polygons

// Return true if a point is inside a polygon (ray crossing).
export function inside(corners, x, y) {
  let within = false;
  for (let i = 0, j = corners.length - 1; i < corners.length; j = i, i += 1) {
    const [xi, yi] = corners[i], [xj, yj] = corners[j];
    if (yi > y !== yj > y && x < (xj - xi) * (y - yi) / (yj - yi) + xi) within = !within;
  }
  return within;
}

// Return true if a point is in a room (if the world has rooms) and in no obstacle.
export function isFree(world, x, y) {
  if (!world) return true;
  const inRoom = !world.rooms.length || world.rooms.some((room) => inside(room.corners, x, y));
  return inRoom && !world.obstacles.some((obstacle) => inside(obstacle.corners, x, y));
}

// Return the point of a segment that is nearest to a point.
export function nearestOn([[x1, y1], [x2, y2]], [x, y]) {
  const [dx, dy] = [x2 - x1, y2 - y1], t = Math.max(0, Math.min(1, ((x - x1) * dx + (y - y1) * dy) / (dx * dx + dy * dy)));
  return [x1 + t * dx, y1 + t * dy];
}

// Return the inner walls of a world as pairs of ends; the outlines of rooms come before them.
export function innerWalls(world) {
  const outlines = world.rooms.reduce((sum, room) => sum + room.corners.length, 0);
  return world.walls.slice(outlines).map(([x1, y1, x2, y2]) => [[x1, y1], [x2, y2]]);
}

// Return walls and closed doors, [x1, y1, x2, y2].
function solidWalls(world) {
  return [...world.walls, ...(world.doors ?? []).filter(({ open }) => !open).map(({ ends }) => ends.flat())];
}

// Return true if a robot at this position seems to fit; the server checks exactly.
export function robotFits(scene, id, [x, y]) {
  const radius = scene.bodies[id].radius_in;
  const distance = (...side) => {
    const [nearX, nearY] = nearestOn(side, [x, y]);
    return Math.hypot(x - nearX, y - nearY);
  };
  const walls = solidWalls(scene.world).map(([a, b, c, d]) => [[a, b], [c, d]]);
  const sides = scene.world.obstacles.flatMap(({ corners }) => corners.map((corner, k) => [corner, corners[(k + 1) % corners.length]]));
  return isFree(scene.world, x, y)
    && [...walls, ...sides].every((side) => distance(...side) > radius)
    && Object.keys(scene.robots).every((other) => other === id
      || Math.hypot(x - scene.robots[other].actual[0], y - scene.robots[other].actual[1]) > radius + scene.bodies[other].radius_in);
}

// Return the point where the lines through two segments meet, or null if they differ by less than 6 degrees.
export function linesMeet([[ax, ay], [bx, by]], [[cx, cy], [dx, dy]]) {
  const [ux, uy, vx, vy] = [bx - ax, by - ay, dx - cx, dy - cy], cross = ux * vy - uy * vx;
  if (Math.abs(cross) < 0.1 * Math.hypot(ux, uy) * Math.hypot(vx, vy)) return null;
  const t = ((cx - ax) * vy - (cy - ay) * vx) / cross;
  return [ax + t * ux, ay + t * uy];
}

// Return the walls and the sides of obstacles, [x1, y1, x2, y2], that come within a distance of a point in x and in y.
export function wallsWithin(world, x, y, distance) {
  const sides = world.obstacles.flatMap(({ corners }) => corners.map((corner, k) => [...corner, ...corners[(k + 1) % corners.length]]));
  return [...solidWalls(world), ...sides].filter(([x1, y1, x2, y2]) => Math.min(x1, x2) < x + distance && Math.max(x1, x2) > x - distance
    && Math.min(y1, y2) < y + distance && Math.max(y1, y2) > y - distance);
}

// Return for each direction the distance from a point to the nearest wall, at most `far`.
export function wallDistances(walls, x, y, angles, far) {
  return angles.map((angle) => {
    const c = Math.cos(angle), s = Math.sin(angle);
    let nearest = far;
    for (const [x1, y1, x2, y2] of walls) {
      // Solve (x, y) + t (c, s) = (x1, y1) + u ((x2, y2) - (x1, y1)) for t > 0 and u from 0 to 1.
      const dx = x2 - x1, dy = y2 - y1, determinant = dx * s - dy * c;
      if (Math.abs(determinant) < 1e-9) continue;
      const t = (dx * (y1 - y) - dy * (x1 - x)) / determinant, u = (c * (y1 - y) - s * (x1 - x)) / determinant;
      if (t > 0 && t < nearest && u >= 0 && u <= 1) nearest = t;
    }
    return nearest;
  });
}

// Return what is wrong with the corners of an obstacle, or '' if they are valid.
export function cornersError(corners) {
  if (corners.length < 3 || corners.length > MAX_CORNERS) {
    return `an obstacle must have 3 to ${MAX_CORNERS} corners, not ${corners.length}`;
  }
  const sides = corners.map((corner, k) => [corner, corners[(k + 1) % corners.length]]);
  for (let i = 0; i < sides.length; i += 1) {
    for (let j = i + 2; j < sides.length; j += 1) {
      // The first and the last side share a corner.
      if ((i > 0 || j < sides.length - 1) && cross(sides[i], sides[j])) return 'the sides of an obstacle may not cross each other';
    }
  }
  const twiceArea = sides.reduce((sum, [[x1, y1], [x2, y2]]) => sum + x1 * y2 - x2 * y1, 0);
  return Math.abs(twiceArea) < 1e-6 ? 'the corners of an obstacle may not all lie on one line' : '';
}

// Return true if two segments cross: the ends of each are on different sides of the other.
function cross([[ax, ay], [bx, by]], [[cx, cy], [dx, dy]]) {
  const side = (px, py, qx, qy, rx, ry) => Math.sign((qx - px) * (ry - py) - (qy - py) * (rx - px));
  return side(ax, ay, bx, by, cx, cy) !== side(ax, ay, bx, by, dx, dy) && side(cx, cy, dx, dy, ax, ay) !== side(cx, cy, dx, dy, bx, by);
}
