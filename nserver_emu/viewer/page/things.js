// The things of a world that tools and the panel World move and delete: obstacles, inner walls, doors, walkers. A thing has a
// name, points, distance(point) in inches (0 on it), move(points, dx, dy) and remove(points), which resolve to answers with the
// new points; walls and doors are `hasEnds`: their ends move one by one, by reshape(points, to). A door has toggle().

import { changeWalls, deleteObstacle, deleteWall, labelWall, moveObstacle, moveWall, stepOn } from './commands.js';
import { innerWalls, inside, linesMeet, nearestOn } from './geometry.js';

// Inches per second.
export const WALKING_SPEED = 20;

export function listThings(app, world = app.scene.world) {
  return world ? [...obstacles(app, world), ...walls(app, world), ...doors(app, world), ...walkers(app, world)] : [];
}

const shifted = (points, dx, dy) => points.map(([x, y]) => [x + dx, y + dy]);
const distanceTo = (points, at) => Math.min(...points.slice(1).map((end, k) => {
  const [x, y] = nearestOn([points[k], end], at);
  return Math.hypot(x - at[0], y - at[1]);
}));

function obstacles(app, world) {
  return world.obstacles.map(({ name, corners }, k) => ({
    name: name || `obstacle ${k + 1}`, points: corners, distance: ([x, y]) => (inside(corners, x, y) ? 0 : Infinity),
    move: (points, dx, dy) => moveObstacle(app, points, dx, dy), remove: (points) => deleteObstacle(app, { corners: points }) }));
}

function walls(app, world) {
  return innerWalls(world).map((ends, k) => ({
    name: world.wall_names?.[k] || `wall ${k + 1}`, points: ends, hasEnds: true, distance: (at) => distanceTo(ends, at),
    rename: (points, name) => labelWall(app, points, name),
    reshape: (points, to) => moveWall(app, points, to),
    move: (points, dx, dy) => moveWall(app, points, shifted(points, dx, dy)), remove: (points) => deleteWall(app, points) }));
}

// Commands to doors name them; those to walkers name their routes. Answers have the whole thing.
const onlyPoints = (answer) => (answer.ok ? { ...answer, result: { is: answer.result.is?.put } } : answer);

function doors(app, world) {
  return (world.doors ?? []).map(({ name, ends, open }) => {
    const reshape = async (points, to) => onlyPoints(await stepOn(app, 'door', 'move door', { door: name, to },
      ({ was }) => ({ door: name, to: was.put })));
    const toggle = () => stepOn(app, 'door', `${open ? 'close' : 'open'} door ${name}`, { door: name, open: !open }, ({ was }) => ({ door: name, open: was.open }));
    return { name: `door ${name}`, points: ends, hasEnds: true, isOpen: open, distance: (at) => distanceTo(ends, at), toggle, reshape,
      move: (points, dx, dy) => reshape(points, shifted(points, dx, dy)),
      remove: () => stepOn(app, 'door', `delete door ${name}`, { door: name, remove: true }, ({ was }) => was) };
  });
}

function walkers(app, world) {
  return (world.walkers ?? []).map(({ name, points, radius, closed }, k) => {
    const place = app.scene.walkers[k] ?? points[0];
    return { name: name || `walker ${k + 1}`, points, distance: (at) => Math.min(Math.max(0, Math.hypot(at[0] - place[0], at[1] - place[1]) - radius),
      distanceTo(closed ? [...points, points[0]] : points, at)),
    move: async (now, dx, dy) => onlyPoints(await stepOn(app, 'walker', 'move walker', { walker: now, by: [dx, dy] },
      ({ was, is }) => ({ walker: is.put, to: was.put }))),
    remove: (now) => stepOn(app, 'walker', 'delete walker', { walker: now }, ({ was }) => was) };
  });
}

export function addDoor(app, ends) {
  const taken = (app.scene.world.doors ?? []).map(({ name }) => name);
  let number = taken.length + 1;
  while (taken.includes(String(number))) number += 1;
  return stepOn(app, 'door', 'add door', { put: ends, name: String(number) }, () => ({ door: String(number), remove: true }));
}

export function addWalker(app, points, closed) {
  return stepOn(app, 'walker', 'add walker', { put: points, closed, speed: app.walkingSpeed ?? WALKING_SPEED }, ({ is }) => ({ walker: is.put }));
}

// Join two walls: each is extended or cut to where their lines meet; of parallel ones the first takes the whole length.
export function joinWalls(app, one, other) {
  const meeting = linesMeet(one, other);
  const to = (ends, point) => {
    const [first, second] = ends.map(([x, y]) => Math.hypot(x - point[0], y - point[1]));
    return first < second ? [point, ends[1]] : [ends[0], point];
  };
  if (meeting) return changeWalls(app, 'join walls', [one, other].map((wall) => ({ wall, to: to(wall, meeting) })));
  const ends = [...one, ...other], pairs = ends.flatMap((from, k) => ends.slice(k + 1).map((end) => [from, end]));
  const length = ([[x1, y1], [x2, y2]]) => Math.hypot(x2 - x1, y2 - y1);
  const longest = pairs.reduce((best, pair) => (length(pair) > length(best) ? pair : best));
  return changeWalls(app, 'join walls', [{ wall: other }, { wall: one, to: longest }]);
}
