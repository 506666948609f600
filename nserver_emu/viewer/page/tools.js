// Tools for the pointer on the map, one active at a time. down(world) returns true if the tool handles the drag; then
// move, up and cancel follow. Everything is also possible by keyboard in the windows Drive, World and Localization.
// A tool only sends commands: the map shows the state that the server reports.

import { drawRobot, polygonPath, circle, arrow } from './draw.js';
import { element } from './widgets.js';
import { inside, robotFits, toScreen } from './geometry.js';
import { addObstacle, deleteObstacle, moveObstacle, placeRobot } from './commands.js';

const MIN_SIDE_IN = 0.5, MIN_DRAG_PX = 4, CLOSE_PX = 12;
const TOOLS = {
  pan: ['Move map', chooseTool], place: ['Robot', placeTool], turn: ['Turn', turnTool], add: ['Add obstacle', addTool],
  shift: ['Move obstacle', shiftTool], remove: ['Delete obstacle', removeTool], pose: ['Give pose', poseTool],
  waypoint: ['Waypoints', waypointTool],
};

export function setUpTools(app) {
  const bar = document.getElementById('tools'), buttons = {};
  app.chooseTool = (name) => {
    const [title, makeTool] = TOOLS[name];
    app.map.tool?.cancel?.();
    app.map.tool = makeTool(app);
    app.toolName = name;
    for (const [other, button] of Object.entries(buttons)) {
      button.setAttribute('aria-checked', String(other === name));
      button.tabIndex = other === name ? 0 : -1;
    }
    app.map.canvas.ariaDescription = `Pointer tool: ${title}`;
    app.map.canvas.style.cursor = name === 'pan' ? 'grab' : 'crosshair';
    app.map.requestRedraw();
  };
  for (const [name, [title]] of Object.entries(TOOLS)) {
    buttons[name] = element('button', { type: 'button', id: `tool-${name}`, onclick: () => app.chooseTool(name) }, title);
    buttons[name].setAttribute('role', 'radio');
    bar.append(buttons[name]);
  }
  // Arrow keys select the next tool, as in any radio group.
  bar.addEventListener('keydown', (event) => {
    const names = Object.keys(TOOLS), step = { ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1 }[event.key];
    if (!step) return;
    event.preventDefault();
    const next = names[(names.indexOf(app.toolName) + step + names.length) % names.length];
    app.chooseTool(next);
    buttons[next].focus();
  });
  app.chooseTool('pan');
}

function robotAt(app, [x, y]) {
  return Object.keys(app.scene.robots).find((id) => {
    const [rx, ry] = app.scene.robots[id].actual;
    return Math.hypot(x - rx, y - ry) <= (app.scene.bodies[id]?.radius_in ?? 0);
  });
}

// The topmost obstacle at a point: the last one drawn.
function obstacleAt(app, [x, y]) {
  return (app.scene.world?.obstacles ?? []).findLast(({ corners }) => inside(corners, x, y)) ?? null;
}

function outline(pen, view, corners, theme) {
  pen.strokeStyle = theme.accent;
  pen.lineWidth = 2;
  polygonPath(pen, view, corners);
  pen.stroke();
}

// Move the map; a click on a robot selects it.
function chooseTool(app) {
  return {
    tap(world) { const id = robotAt(app, world); if (id) app.selectRobot(id); },
  };
}

// Drag a preview of a robot; the robot is placed there when the pointer is released.
function previewTool(app, change) {
  let id = null, grip = null, preview = null, start = null, isDragged = false;
  return {
    down(world) {
      id = robotAt(app, world) ?? null;
      if (id === null) return false;
      app.selectRobot(id);
      preview = [...app.scene.robots[id].actual];
      grip = [world[0] - preview[0], world[1] - preview[1]];
      start = world;
      isDragged = false;
      return true;
    },
    move(world, event) {
      isDragged ||= app.map.pixels(start, world) > MIN_DRAG_PX;
      if (isDragged) change(preview, world, grip, event);
    },
    up() { if (isDragged) placeRobot(app, id, preview); id = null; },
    cancel() { id = null; },
    draw(pen, scene, view, { theme }) {
      if (id !== null) drawRobot(pen, preview, app.scene.bodies[id], view, { dashed: true,
        colour: robotFits(app.scene, id, preview) ? theme.accent : theme.hit });
    },
  };
}

function placeTool(app) {
  return previewTool(app, (preview, [x, y], [gx, gy]) => { preview[0] = x - gx; preview[1] = y - gy; });
}

// Turn steering and turret together; with Shift only the turret.
function turnTool(app) {
  return previewTool(app, (preview, [x, y], grip, event) => {
    const angle = Math.atan2(y - preview[1], x - preview[0]);
    if (!event.shiftKey) preview[2] = angle;
    preview[3] = angle;
  });
}

function rectangle([x1, y1], [x2, y2]) {
  const [a, b, c, d] = [Math.min(x1, x2), Math.min(y1, y2), Math.max(x1, x2), Math.max(y1, y2)];
  return [[a, b], [c, b], [c, d], [a, d]];
}

// Drag a rectangle, or click one corner after another and then the first again.
function addTool(app) {
  let first = null, here = null, corners = [];
  const closes = (world) => corners.length >= 3 && app.map.pixels(corners[0], world) < CLOSE_PX;
  return {
    down(world) { first = here = world; return true; },
    move(world) { here = world; },
    up(world) {
      const isDragged = Math.abs(world[0] - first[0]) > MIN_SIDE_IN && Math.abs(world[1] - first[1]) > MIN_SIDE_IN
        && app.map.pixels(first, world) > 2 * MIN_DRAG_PX;
      if (isDragged && !corners.length) addObstacle(app, rectangle(first, world));
      else if (closes(world)) { addObstacle(app, corners); corners = []; }
      else corners.push(world);
      first = here = null;
    },
    cancel() { first = here = null; corners = []; },
    draw(pen, scene, view, { theme }) {
      const path = first && !corners.length ? rectangle(first, here) : [...corners, ...(here ? [here] : [])];
      if (!path.length) return;
      outline(pen, view, path, theme);
      for (const [x, y] of path) { circle(pen, view, x, y, 4 / view.scale); pen.stroke(); }
    },
  };
}

function shiftTool(app) {
  let obstacle = null, start = null, here = null;
  return {
    down(world) { obstacle = obstacleAt(app, world); start = here = world; return Boolean(obstacle); },
    move(world) { here = world; },
    up() { moveObstacle(app, obstacle.corners, here[0] - start[0], here[1] - start[1]); obstacle = null; },
    cancel() { obstacle = null; },
    draw(pen, scene, view, { theme }) {
      if (obstacle) outline(pen, view, obstacle.corners.map(([x, y]) => [x + here[0] - start[0], y + here[1] - start[1]]), theme);
    },
  };
}

function removeTool(app) {
  let obstacle = null;
  return {
    down(world) { obstacle = obstacleAt(app, world); return Boolean(obstacle); },
    up(world) { if (obstacleAt(app, world) === obstacle) deleteObstacle(app, obstacle); obstacle = null; },
    cancel() { obstacle = null; },
  };
}

// Press at the position and drag towards the heading: the reply to get_robot_conf.
function poseTool(app) {
  let start = null, here = null;
  const heading = () => Math.atan2(here[1] - start[1], here[0] - start[0]);
  return {
    down(world) { start = here = world; return true; },
    move(world) { here = world; },
    up() {
      const angle = app.map.pixels(start, here) > 2 * MIN_DRAG_PX ? heading() : 0;
      app.givePose([...start, angle, angle]);
      start = null;
    },
    cancel() { start = null; },
    draw(pen, scene, view, { theme }) {
      if (!start) return;
      pen.strokeStyle = pen.fillStyle = theme.accent;
      pen.lineWidth = 2;
      circle(pen, view, start[0], start[1], 4 / view.scale);
      pen.stroke();
      const length = Math.hypot(here[0] - start[0], here[1] - start[1]);
      if (length > MIN_SIDE_IN) arrow(pen, view, start[0], start[1], heading(), length);
    },
  };
}

// A click adds a waypoint at the end; an existing one can be dragged, or deleted by a click.
function waypointTool(app) {
  let index = -1, start = null, here = null;
  return {
    down(world) {
      index = remainingWaypoints(app).findIndex((point) => app.map.pixels(point, world) < CLOSE_PX);
      start = here = world;
      return true;
    },
    move(world) { here = world; },
    up(world) {
      const points = remainingWaypoints(app).map((point) => [...point]);
      if (index < 0) points.push(roundToTenths(world));
      else if (app.map.pixels(start, world) < CLOSE_PX / 2) points.splice(index, 1);
      else points[index] = roundToTenths(world);
      index = -1;
      app.setWaypoints(points);
    },
    cancel() { index = -1; },
    draw(pen, scene, view, { theme }) {
      if (index >= 0) drawWaypoints(pen, remainingWaypoints(app).map((point, k) => (k === index ? here : point)), view, theme);
    },
  };
}

export function roundToTenths(point) { return point.map((number) => Math.round(number * 10) / 10); }

// The waypoints that the selected robot has not reached: from its localizer, unless a page has just changed them.
export function remainingWaypoints(app) {
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
    const [px, py] = toScreen(view, x, y);
    pen.fillText(String(k + 1), px + 8, py - 6);
  });
}
