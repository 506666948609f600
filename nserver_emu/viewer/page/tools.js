// What a pointer does on the map besides moving it: one tool at a time. A tool answers down(world) with true when it
// takes the pointer; move, up and cancel follow. Every tool has a way by keyboard in Drive, World or Localization.
// Rules: nothing moves on the map by itself; the daemon is asked, and what it says is shown.

import { drawRobot, polygonPath, circle, arrow } from './draw.js';
import { tenthsOf, angleTenths } from './units.js';
import { element } from './parts.js';
import { cornersWrong, inside, isFree } from './ground.js';
import { control } from './control.js';

const TOOLS = { pan: 'Move map', place: 'Robot', turn: 'Turn', add: 'Add obstacle', shift: 'Move obstacle',
  remove: 'Delete obstacle', pose: 'Give pose', waypoint: 'Waypoints' };
const LEAST_IN = 0.5, LEAST_PX = 4;

export function setUpTools(app) {
  const bar = document.getElementById('tools'), buttons = {};
  const makers = { pan: chooseTool, place: placeTool, turn: turnTool, add: addTool, shift: shiftTool, remove: removeTool,
    pose: poseTool, waypoint: waypointTool };
  app.choose = (name) => {
    app.map.tool?.cancel?.();
    app.map.tool = makers[name](app);
    app.toolName = name;
    for (const [other, made] of Object.entries(buttons)) {
      made.setAttribute('aria-checked', String(other === name));
      made.tabIndex = other === name ? 0 : -1;
    }
    app.map.canvas.ariaDescription = `What the pointer does: ${TOOLS[name]}`;
    app.map.canvas.style.cursor = name === 'pan' ? 'grab' : 'crosshair';
    app.map.keepDrawing();
  };
  for (const [name, title] of Object.entries(TOOLS)) {
    buttons[name] = element('button', { type: 'button', role: 'radio', id: `tool-${name}`, onclick: () => app.choose(name) }, title);
    buttons[name].setAttribute('role', 'radio');
    bar.append(buttons[name]);
  }
  bar.addEventListener('keydown', (event) => {
    const names = Object.keys(TOOLS), step = { ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1 }[event.key];
    if (!step) return;
    event.preventDefault();
    const next = names[(names.indexOf(app.toolName) + step + names.length) % names.length];
    app.choose(next);
    buttons[next].focus();
  });
  app.choose('pan');
}

const NOT_POSSIBLE = { add_obstacle: 'An obstacle is not possible there: a robot stands in its way, or it reaches off the map.',
  place_robot: 'The robot does not fit there: a wall, an obstacle or a robot is in its way.' };

// Has a robot do or answer something; what was refused stands in the notice, in plain words where there are some.
export async function tell(app, call, args, robot = Number(app.robot)) {
  const answer = await app.link.ask({ do: 'call', robot, call, args });
  const error = answer.ok ? '' : (answer.code !== undefined && NOT_POSSIBLE[call]) || answer.error;
  app.notice(error);
  return answer.ok ? answer : { ...answer, error };
}

export function placeRobot(app, id, pose) {
  const args = ([x, y, steer, turret]) => [tenthsOf(x), tenthsOf(y), angleTenths(steer), angleTenths(turret)];
  const before = [...app.scene.robots[id].actual];
  return app.undo.run({ title: `place robot ${id}`, forth: () => tell(app, 'place_robot', args(pose), Number(id)),
    back: () => tell(app, 'place_robot', args(before), Number(id)) });
}

function robotAt(app, [x, y]) {
  return Object.keys(app.scene.robots).find((id) => {
    const [rx, ry] = app.scene.robots[id].actual;
    return Math.hypot(x - rx, y - ry) <= (app.scene.bodies[id]?.radius_in ?? 0);
  });
}

function obstacleAt(app, [x, y]) {
  const things = app.scene.world?.obstacles ?? [];
  for (let k = things.length - 1; k >= 0; k -= 1) if (inside(things[k].corners, x, y)) return things[k];
  return null;
}

// Moves the map; a press on a robot without moving chooses it.
function chooseTool(app) {
  return {
    tap(world) { const id = robotAt(app, world); if (id) app.selectRobot(id); },
  };
}

function ghostTool(app, changed) {
  let id = null, grip = null, ghost = null, from = null, dragged = false;
  return {
    down(world) {
      id = robotAt(app, world) ?? null;
      if (id === null) return false;
      app.selectRobot(id);
      ghost = [...app.scene.robots[id].actual];
      grip = [world[0] - ghost[0], world[1] - ghost[1]];
      from = world;
      dragged = false;
      return true;
    },
    move(world, event) {
      dragged ||= app.map.pixels(from, world) > LEAST_PX;
      if (dragged) changed(ghost, world, grip, event);
    },
    up() { if (dragged) placeRobot(app, id, ghost); id = null; },
    cancel() { id = null; },
    draw(pen, scene, view, { theme }) {
      if (id !== null) drawRobot(pen, ghost, app.scene.bodies[id], view, { dashed: true,
        colour: fits(app, ghost, id) ? theme.accent : theme.hit });
    },
  };
}

// Whether a robot seems to fit there; the daemon knows better.
function fits(app, [x, y], id) {
  const { scene } = app, radius = scene.bodies[id].radius_in;
  const apart = ([x1, y1], [x2, y2]) => {
    const [dx, dy] = [x2 - x1, y2 - y1], t = Math.max(0, Math.min(1, ((x - x1) * dx + (y - y1) * dy) / (dx * dx + dy * dy)));
    return Math.hypot(x - x1 - t * dx, y - y1 - t * dy);
  };
  const sides = scene.world.obstacles.flatMap(({ corners }) => corners.map((corner, k) => [corner, corners[(k + 1) % corners.length]]));
  return isFree(scene.world, x, y)
    && [...scene.world.walls.map(([a, b, c, d]) => [[a, b], [c, d]]), ...sides].every((side) => apart(...side) > radius)
    && Object.keys(scene.robots).every((other) => other === id
      || Math.hypot(x - scene.robots[other].actual[0], y - scene.robots[other].actual[1]) > radius + scene.bodies[other].radius_in);
}

function placeTool(app) {
  return ghostTool(app, (ghost, [x, y], [gx, gy]) => { ghost[0] = x - gx; ghost[1] = y - gy; });
}

// Turns steering and turret together; with Shift the turret alone.
function turnTool(app) {
  return ghostTool(app, (ghost, [x, y], grip, event) => {
    const angle = Math.atan2(y - ghost[1], x - ghost[0]);
    if (!event.shiftKey) ghost[2] = angle;
    ghost[3] = angle;
  });
}

function flat(corners) { return [corners.length, ...corners.flat().map(tenthsOf)]; }

// Obstacles: a step is about one of them, and so is its undo, to the last digit; what others did meanwhile stays. Where
// they changed that very one, undo says so.

function obstacleStep(app, title, forth, undoing) {
  let told = null;
  const ask = async (wanted) => {
    const answer = await control(app, 'obstacle', wanted);
    return answer.ok ? answer : { ...answer, error: answer.error.replace(/^obstacle: there is none.*/, 'it has been moved or taken away meanwhile') };
  };
  return app.undo.run({ title, forth: async () => {
    const answer = await forth();
    if (answer.ok) told = answer.said ?? null;
    return answer;
  }, back: () => ask(undoing(told)) });
}

export async function addObstacle(app, corners) {
  const wrong = cornersWrong(corners);
  if (wrong) { app.notice(`Not possible: ${wrong}.`); return { ok: false, error: wrong }; }
  const added = corners.map((corner) => corner.map((inches) => tenthsOf(inches) / 10));
  return obstacleStep(app, 'add obstacle', () => tell(app, 'add_obstacle', flat(corners)), () => ({ corners: added }));
}

export function deleteObstacle(app, { corners }) {
  return obstacleStep(app, 'delete obstacle', () => control(app, 'obstacle', { corners }),
    (told) => ({ put: told.was, name: told.name, at: told.at }));
}

export function moveObstacle(app, corners, dx_in, dy_in) {
  return obstacleStep(app, 'move obstacle', () => control(app, 'obstacle', { corners, by: [dx_in, dy_in] }),
    (told) => ({ corners: told.is, to: told.was }));
}

export function rectangle([x1, y1], [x2, y2]) {
  const [a, b, c, d] = [Math.min(x1, x2), Math.min(y1, y2), Math.max(x1, x2), Math.max(y1, y2)];
  return [[a, b], [c, b], [c, d], [a, d]];
}

// Drag a rectangle, or click corner after corner and the first once more.
function addTool(app) {
  let first = null, here = null, corners = [];
  const closes = (world) => corners.length >= 3 && app.map.pixels(corners[0], world) < 12;
  return {
    down(world) { first = here = world; return true; },
    move(world) { here = world; },
    up(world) {
      const dragged = Math.abs(world[0] - first[0]) > LEAST_IN && Math.abs(world[1] - first[1]) > LEAST_IN
        && app.map.pixels(first, world) > 8;
      if (dragged && !corners.length) addObstacle(app, rectangle(first, world));
      else if (closes(world)) { addObstacle(app, corners); corners = []; }
      else corners.push(world);
      first = here = null;
    },
    cancel() { first = here = null; corners = []; },
    draw(pen, scene, view, { theme }) {
      const path = first && !corners.length ? rectangle(first, here) : [...corners, ...(here ? [here] : [])];
      if (!path.length) return;
      pen.strokeStyle = theme.accent;
      pen.lineWidth = 2;
      polygonPath(pen, view, path);
      pen.stroke();
      for (const [x, y] of path) { circle(pen, view, x, y, 4 / view.scale); pen.stroke(); }
    },
  };
}

function shiftTool(app) {
  let thing = null, from = null, here = null;
  return {
    down(world) { thing = obstacleAt(app, world); from = here = world; return Boolean(thing); },
    move(world) { here = world; },
    up() { moveObstacle(app, thing.corners, here[0] - from[0], here[1] - from[1]); thing = null; },
    cancel() { thing = null; },
    draw(pen, scene, view, { theme }) {
      if (!thing) return;
      pen.strokeStyle = theme.accent;
      pen.lineWidth = 2;
      polygonPath(pen, view, thing.corners.map(([x, y]) => [x + here[0] - from[0], y + here[1] - from[1]]));
      pen.stroke();
    },
  };
}

function removeTool(app) {
  let thing = null;
  return {
    down(world) { thing = obstacleAt(app, world); return Boolean(thing); },
    up(world) { if (obstacleAt(app, world) === thing) deleteObstacle(app, thing); thing = null; },
    cancel() { thing = null; },
  };
}

// Press at the place, drag to where it heads; answers get_robot_conf.
function poseTool(app) {
  let from = null, here = null;
  return {
    down(world) { from = here = world; return true; },
    move(world) { here = world; },
    up() {
      const turned = app.map.pixels(from, here) > 8 ? Math.atan2(here[1] - from[1], here[0] - from[0]) : 0;
      app.givePose([...from, turned, turned]);
      from = null;
    },
    cancel() { from = null; },
    draw(pen, scene, view, { theme }) {
      if (!from) return;
      pen.strokeStyle = pen.fillStyle = theme.accent;
      pen.lineWidth = 2;
      circle(pen, view, from[0], from[1], 4 / view.scale);
      pen.stroke();
      const length = Math.hypot(here[0] - from[0], here[1] - from[1]);
      if (length > LEAST_IN) arrow(pen, view, from[0], from[1], Math.atan2(here[1] - from[1], here[0] - from[0]), length);
    },
  };
}

// A press sets a way-point behind the last; one that is there is dragged elsewhere, or taken away by a press on it.
function waypointTool(app) {
  let held = -1, from = null, here = null;
  return {
    down(world) {
      held = pointsNow(app).findIndex((point) => app.map.pixels(point, world) < 12);
      from = here = world;
      return true;
    },
    move(world) { here = world; },
    up(world) {
      const points = pointsNow(app).map((point) => [...point]);
      if (held < 0) points.push(tenthed(world));
      else if (app.map.pixels(from, world) < 6) points.splice(held, 1);
      else points[held] = tenthed(world);
      held = -1;
      app.setWaypoints(points);
    },
    cancel() { held = -1; },
    draw(pen, scene, view, { theme }) {
      if (held >= 0) drawWaypoints(pen, pointsNow(app).map((point, k) => (k === held ? here : point)), view, theme);
    },
  };
}

export function tenthed(point) { return point.map((number) => Math.round(number * 10) / 10); }

// Where the chosen robot has still to go: as its localizer says, else as set at a page.
export function pointsNow(app) {
  const estimate = app.estimateOf(app.robot), set = app.waypoints[app.robot];
  return estimate && !(set && app.justSet(app.robot)) ? estimate.waypoints.slice(estimate.passed) : set ?? [];
}

export function drawWaypoints(pen, points, view, theme) {
  pen.strokeStyle = pen.fillStyle = theme.estimate;
  pen.lineWidth = 1.5;
  pen.font = '12px system-ui, sans-serif';
  points.forEach(([x, y], k) => {
    circle(pen, view, x, y, 5 / view.scale);
    pen.stroke();
    const px = view.width / 2 + (x - view.x) * view.scale, py = view.height / 2 - (y - view.y) * view.scale;
    pen.fillText(String(k + 1), px + 8, py - 6);
  });
}
