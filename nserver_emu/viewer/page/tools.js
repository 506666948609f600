// What a pointer does on the map besides moving it: one tool at a time. A tool answers down(world) with true when it
// takes the pointer; move, up and cancel follow. Every tool has a way by keyboard in the window World or Robot.
// Rules: nothing moves on the map by itself; the daemon is asked, and what it says is shown.

import { drawRobot, polygonPath, circle, arrow } from './draw.js';
import { tenthsOf, angleTenths } from './units.js';
import { element } from './parts.js';

const TOOLS = { pan: 'Move map', place: 'Robot', turn: 'Turn', add: 'Add obstacle', shift: 'Move obstacle',
  remove: 'Delete obstacle', pose: 'Give pose', waypoint: 'Waypoints' };
const LEAST_IN = 0.5;

export function setUpTools(app) {
  const bar = document.getElementById('tools'), buttons = {};
  const makers = { pan: () => null, place: placeTool, turn: turnTool, add: addTool, shift: shiftTool, remove: removeTool,
    pose: poseTool, waypoint: waypointTool };
  app.choose = (name) => {
    app.map.tool?.cancel?.();
    app.map.tool = makers[name](app);
    app.toolName = name;
    for (const [other, made] of Object.entries(buttons)) {
      made.setAttribute('aria-checked', String(other === name));
      made.tabIndex = other === name ? 0 : -1;
    }
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

export async function tell(app, call, args, robot = Number(app.robot)) {
  const answer = await app.link.ask({ do: 'call', robot, call, args });
  app.notice(answer.ok ? '' : answer.error);
  return answer;
}

export function placeRobot(app, id, [x, y, steer, turret]) {
  return tell(app, 'place_robot', [tenthsOf(x), tenthsOf(y), angleTenths(steer), angleTenths(turret)], Number(id));
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

export function inside(corners, x, y) {
  let within = false;
  for (let i = 0, j = corners.length - 1; i < corners.length; j = i, i += 1) {
    const [xi, yi] = corners[i], [xj, yj] = corners[j];
    if (yi > y !== yj > y && x < (xj - xi) * (y - yi) / (yj - yi) + xi) within = !within;
  }
  return within;
}

function ghostTool(app, changed) {
  let id = null, grip = null, ghost = null;
  return {
    down(world) {
      id = robotAt(app, world) ?? null;
      if (id === null) return false;
      app.selectRobot(id);
      ghost = [...app.scene.robots[id].actual];
      grip = [world[0] - ghost[0], world[1] - ghost[1]];
      return true;
    },
    move(world, event) { changed(ghost, world, grip, event); },
    up() { placeRobot(app, id, ghost); id = null; },
    cancel() { id = null; },
    draw(pen, scene, view, { theme }) {
      if (id !== null) drawRobot(pen, ghost, app.scene.bodies[id], view, { colour: theme.accent, dashed: true });
    },
  };
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

export async function addObstacle(app, corners) {
  const answer = await tell(app, 'add_obstacle', flat(corners));
  if (answer.ok) app.undo.push({ title: 'add obstacle', back: () => tell(app, 'delete_obstacle', flat(corners)) });
  return answer;
}

export async function deleteObstacle(app, corners) {
  const answer = await tell(app, 'delete_obstacle', flat(corners));
  if (answer.ok) app.undo.push({ title: 'delete obstacle', back: () => tell(app, 'add_obstacle', flat(corners)) });
  return answer;
}

export async function moveObstacle(app, corners, dx, dy) {
  const answer = await tell(app, 'move_obstacle', [...flat(corners), tenthsOf(dx), tenthsOf(dy)]);
  const moved = corners.map(([x, y]) => [x + tenthsOf(dx) / 10, y + tenthsOf(dy) / 10]);
  if (answer.ok) {
    app.undo.push({ title: 'move obstacle', back: () => tell(app, 'move_obstacle', [...flat(moved), tenthsOf(-dx), tenthsOf(-dy)]) });
  }
  return answer;
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
    up(world) { if (obstacleAt(app, world) === thing) deleteObstacle(app, thing.corners); thing = null; },
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

function waypointTool(app) {
  return {
    down: () => true,
    up(world) { app.waypoints.push(world.map((number) => Math.round(number * 10) / 10)); app.waypointsChanged(); },
    draw(pen, scene, view, { theme }) { drawWaypoints(pen, app.waypoints, view, theme); },
  };
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
