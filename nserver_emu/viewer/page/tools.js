// Tools for the pointer on the map, one active at a time, chosen by buttons in the panels. down(world) returns true if the
// tool handles the drag; then move, up and cancel follow. finish() is called by Enter, and returns true if there was
// something to finish. cancel() returns true if there was something to cancel. Everything is also possible by keyboard in
// the panels. A tool only sends commands: the map shows the state that the server reports.

import { drawRobot, polygonPath, circle, arrow } from './draw.js';
import { element } from './widgets.js';
import { isFree, robotFits, toScreen } from './geometry.js';
import { addObstacle, addWall, placeRobot } from './commands.js';
import { addDoor, addWalker, joinWalls, listThings } from './things.js';

const MIN_SIDE_IN = 0.5, MIN_DRAG_PX = 4, CLOSE_PX = 12;
const WRONG_PLACE_MS = 5000;
// task: the panel with the button; hint: how to use it; wants: where it must be used; icon: a path in a box of 16 x 16.
const TOOLS = {
  pan: { title: 'Move map', make: chooseTool },
  place: { title: 'Move robot', make: placeTool, task: 'drive', icon: 'M8 1v14M1 8h14M6 3l2-2 2 2M6 13l2 2 2-2M3 6L1 8l2 2M13 6l2 2-2 2',
    hint: 'Drag a robot to its new place.', wants: 'There is no robot: press on one and drag it.' },
  turn: { title: 'Turn robot', make: turnTool, task: 'drive', icon: 'M13 8a5 5 0 1 1-2-4M11 1v3H8',
    hint: 'Press on a robot and drag towards its new heading; with Shift only the turret.', wants: 'There is no robot: press on one and drag.' },
  pose: { title: 'Give pose', make: poseTool, task: 'drive', icon: 'M4 12a2 2 0 1 0 .1 0M6 10l7-7M9 3h4v4',
    hint: 'Press at the position and drag towards the heading: the answer to a program that asks for a pose.' },
  add: { title: 'Add obstacle', make: addTool, task: 'world', icon: 'M2 4h8v8H2zM13 1v6M10 4h6',
    hint: 'Drag a rectangle, or click corner after corner; Enter closes the outline.' },
  wall: { title: 'Draw wall', make: segmentTool(addWall), task: 'world', icon: 'M2 13L11 4M13 1v6M10 4h6',
    hint: 'Drag from one end of the wall to the other. Ends near those of other walls join them.', wants: 'A wall has a length: press at one end and drag to the other.' },
  door: { title: 'Add door', make: segmentTool(addDoor), task: 'world', icon: 'M3 14V2h7v12M10 14V5l4-2v11M1 14h14',
    hint: 'Drag across a gap, from one side of the door to the other. Ends near those of walls join them.', wants: 'A door has a width: press at one side and drag to the other.' },
  walker: { title: 'Add walker', make: walkerTool, task: 'world', icon: 'M8 1a1.5 1.5 0 1 0 .1 0M8 5v5M8 10l-3 5M8 10l3 5M4 8l4-2 4 2',
    hint: 'Click point after point of a route; Enter ends it, a click on the first point closes it.', wants: 'A person cannot walk there: click on free space.' },
  length: { title: 'Measure', make: lengthTool, task: 'world', icon: 'M2 11V5h12v6zM5 5v3M8 5v3M11 5v3',
    hint: 'Drag from one end of a wall to another one, then enter the length that a tape measured in the panel.', wants: 'A length is between two ends of walls: drag from one to the other.' },
  join: { title: 'Join', make: joinTool, task: 'world', icon: 'M2 13h11M13 13V2M10 10l3 3',
    hint: 'Click one inner wall, then another: both end where their lines meet; parallel walls become one.', wants: 'There is no inner wall: click on one, then on the one that it joins.' },
  label: { title: 'Label', make: labelTool, task: 'world', icon: 'M2 3h7l5 5-5 5H2zM5 8h.1',
    hint: 'Click an inner wall, then enter its name in the panel.', wants: 'There is no inner wall: click on one to name it.' },
  shift: { title: 'Move', make: shiftTool, task: 'world', icon: 'M2 5h7v7H2zM10 8h5M13 6l2 2-2 2',
    hint: 'Drag an obstacle, an inner wall, a door or a walker; near its end a wall turns.', wants: 'There is nothing to move: press on a grey obstacle, an inner wall, a door or a walker and drag it. The outlines of rooms stay.' },
  remove: { title: 'Delete', make: removeTool, task: 'world', icon: 'M2 4h8v8H2zM11 2l4 4M15 2l-4 4',
    hint: 'Click on an obstacle, an inner wall, a door or a walker to delete it.', wants: 'There is nothing to delete: click on a grey obstacle, an inner wall, a door or a walker. The outlines of rooms stay.' },
  waypoint: { title: 'Waypoints', make: waypointTool, task: 'localize', icon: 'M3 13l4-5 3 2 4-7M3 13h.1M14 3h.1',
    hint: 'Click to add a waypoint; drag one to move it, click it to delete it.', wants: 'A robot cannot stand there: click on free space.' },
};
const TOOL_GROUPS = { drive: 'Robot on the map', world: 'Walls and obstacles on the map', localize: 'Waypoints on the map' };

export function setUpTools(app) {
  const buttons = {}, bar = document.getElementById('tool-hint'), [words, done] = bar.children;
  let timer = null;
  const showHint = (text, isError) => {
    clearTimeout(timer);
    words.textContent = text;
    bar.classList.toggle('error', isError);
  };
  app.chooseTool = (name) => {
    const { title, make, hint = '' } = TOOLS[name];
    app.map.tool?.cancel?.();
    app.map.tool = make(app);
    app.toolName = name;
    for (const [other, button] of Object.entries(buttons)) button.setAttribute('aria-pressed', String(other === name));
    bar.hidden = name === 'pan';
    showHint(hint, false);
    app.map.canvas.ariaDescription = `Pointer tool: ${title}. ${hint}`;
    app.map.canvas.style.cursor = name === 'pan' ? 'grab' : 'crosshair';
    app.map.requestRedraw();
  };
  // A click where the tool can do nothing says what it wants.
  app.rejectPlace = () => {
    const { hint, wants } = TOOLS[app.toolName];
    if (!wants) return;
    showHint(wants, true);
    timer = setTimeout(() => showHint(hint, false), WRONG_PLACE_MS);
  };
  for (const [task, label] of Object.entries(TOOL_GROUPS)) {
    const row = element('div', { className: 'row tools acts live', role: 'group', ariaLabel: label });
    for (const [name, { title, icon, hint }] of Object.entries(TOOLS).filter(([, tool]) => tool.task === task)) {
      buttons[name] = element('button', { type: 'button', id: `tool-${name}`, title: hint,
        onclick: () => app.chooseTool(app.toolName === name ? 'pan' : name) }, iconOf(icon), title);
      row.append(buttons[name]);
    }
    document.querySelector(`#task-${task} > h2`).after(row);
  }
  done.addEventListener('click', () => app.finishTool());
  // Enter: finish what is being drawn, then the tool.
  app.finishTool = () => { if (!app.map.tool.finish?.()) app.chooseTool('pan'); };
  document.addEventListener('keydown', (event) => {
    if (event.key !== 'Enter' || app.toolName === 'pan' || event.target.closest?.('button, input, select, textarea, summary, a')) return;
    event.preventDefault();
    app.finishTool();
  });
  app.chooseTool('pan');
}

function iconOf(path) {
  const svg = document.createElementNS('http://www.w3.org/2000/svg', 'svg'), line = document.createElementNS(svg.namespaceURI, 'path');
  for (const [name, value] of [['viewBox', '0 0 16 16'], ['aria-hidden', 'true'], ['class', 'icon']]) svg.setAttribute(name, value);
  line.setAttribute('d', path);
  svg.append(line);
  return svg;
}

function robotAt(app, [x, y]) {
  return Object.keys(app.scene.robots).find((id) => {
    const [rx, ry] = app.scene.robots[id].actual;
    return Math.hypot(x - rx, y - ry) <= (app.scene.bodies[id]?.radius_in ?? 0);
  });
}

// The topmost thing at a point, or null; [thing, end], where end is 0 or 1 near an end of a wall or door, otherwise null.
function thingAt(app, point) {
  const thing = listThings(app).findLast(({ distance }) => distance(point) * app.map.view.scale < CLOSE_PX) ?? null;
  if (!thing) return null;
  const end = thing.hasEnds ? thing.points.findIndex((one) => app.map.pixels(one, point) < CLOSE_PX) : -1;
  return [thing, end < 0 ? null : end];
}

// The end of a wall near a point, or the point itself.
function snapped(app, point) {
  const ends = (app.scene.world?.walls ?? []).flatMap(([x1, y1, x2, y2]) => [[x1, y1], [x2, y2]]);
  return ends.find((end) => app.map.pixels(end, point) < CLOSE_PX) ?? roundToTenths(point);
}

function drawLine(pen, view, [start, end], theme) {
  pen.strokeStyle = theme.accent;
  pen.lineWidth = 3;
  pen.beginPath();
  pen.moveTo(...toScreen(view, ...start));
  pen.lineTo(...toScreen(view, ...end));
  pen.stroke();
}

// Drag from one end of a new wall or door to the other.
function segmentTool(add) {
  return (app) => newSegmentTool(app, (ends) => add(app, ends));
}

function newSegmentTool(app, add) {
  let start = null, here = null;
  return {
    down(world) { start = here = snapped(app, world); return true; },
    move(world) { here = snapped(app, world); },
    up() {
      if (app.map.pixels(start, here) > 2 * MIN_DRAG_PX) add([start, here]);
      else app.rejectPlace();
      start = null;
    },
    cancel() { const isDragging = start !== null; start = null; return isDragging; },
    draw(pen, scene, view, { theme }) { if (start) drawLine(pen, view, [start, here], theme); },
  };
}

// Drag between two ends of walls whose distance a tape has measured.
function lengthTool(app) {
  const line = newSegmentTool(app, (ends) => app.measure(ends));
  return { ...line, draw(pen, scene, view, options) {
    line.draw(pen, scene, view, options);
    for (const { ends } of app.tapes ?? []) drawLine(pen, view, ends, options.theme);
  } };
}

function outline(pen, view, corners, theme) {
  pen.strokeStyle = theme.accent;
  pen.lineWidth = 2;
  polygonPath(pen, view, corners);
  pen.stroke();
}

// Move the map; a click on a robot selects it, one on a door opens or closes it.
function chooseTool(app) {
  return {
    tap(world) {
      const id = robotAt(app, world), door = id || !app.mayAct ? null : thingAt(app, world)?.[0];
      if (id) app.selectRobot(id);
      else door?.toggle?.();
    },
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
    cancel() { const isDragging = id !== null; id = null; return isDragging; },
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
    cancel() {
      const isDrawing = Boolean(first || corners.length);
      first = here = null;
      corners = [];
      return isDrawing;
    },
    finish() {
      const outlined = corners;
      if (outlined.length < 3) return this.cancel();
      corners = [];
      here = null;
      addObstacle(app, outlined);
      return true;
    },
    draw(pen, scene, view, { theme }) {
      const path = first && !corners.length ? rectangle(first, here) : [...corners, ...(here ? [here] : [])];
      if (!path.length) return;
      outline(pen, view, path, theme);
      for (const [x, y] of path) { circle(pen, view, x, y, 4 / view.scale); pen.stroke(); }
    },
  };
}

// Drag a thing, or one end of a wall or door.
function shiftTool(app) {
  let thing = null, end = null, start = null, here = null;
  const moved = () => thing.points.map((point, k) => {
    if (end !== null) return end === k ? snapped(app, here) : point;
    return [point[0] + here[0] - start[0], point[1] + here[1] - start[1]];
  });
  return {
    down(world) {
      [thing, end] = thingAt(app, world) ?? [null, null];
      start = here = world;
      return Boolean(thing);
    },
    move(world) { here = world; },
    up() {
      if (app.map.pixels(start, here) > MIN_DRAG_PX) {
        if (end === null) thing.move(thing.points, here[0] - start[0], here[1] - start[1]);
        else thing.reshape(thing.points, moved());
      }
      thing = null;
    },
    cancel() { const isDragging = Boolean(thing); thing = null; return isDragging; },
    draw(pen, scene, view, { theme }) {
      if (!thing) return;
      if (thing.hasEnds) drawLine(pen, view, moved(), theme);
      else outline(pen, view, moved(), theme);
    },
  };
}

// Click one wall, then the other.
function joinTool(app) {
  let first = null;
  return {
    tap(world) {
      const thing = thingAt(app, world)?.[0];
      if (!thing?.hasEnds || thing.toggle || String(thing.points) === String(first)) { app.rejectPlace(); return; }
      if (first) joinWalls(app, first, thing.points);
      first = first ? null : thing.points;
    },
    cancel() { const isChosen = first !== null; first = null; return isChosen; },
    draw(pen, scene, view, { theme }) { if (first) drawLine(pen, view, first, theme); },
  };
}

function labelTool(app) {
  return {
    tap(world) {
      const thing = thingAt(app, world)?.[0];
      if (thing?.rename) app.label(thing);
      else app.rejectPlace();
    },
  };
}

function removeTool(app) {
  let thing = null;
  return {
    down(world) {
      thing = thingAt(app, world)?.[0] ?? null;
      return Boolean(thing);
    },
    up(world) {
      const released = thingAt(app, world)?.[0];
      if (released?.name === thing.name && String(released.points) === String(thing.points)) thing.remove(thing.points);
      thing = null;
    },
    cancel() { const isDragging = Boolean(thing); thing = null; return isDragging; },
  };
}

// Click point after point of a route; a click on the first one closes it, Enter or a click on the last one ends it.
function walkerTool(app) {
  let points = [], here = null;
  const add = async (closed) => {
    const route = points;
    points = []; here = null;
    const answer = await addWalker(app, route, closed);
    // A refused route stays, unless another one was begun: what is in its way may move.
    if (!answer.ok && !points.length) { points = route; app.map.requestRedraw(); }
  };
  return {
    down(world) { here = world; return true; },
    move(world) { here = world; },
    up(world) {
      const isAt = (point) => point && app.map.pixels(point, world) < CLOSE_PX;
      if (points.length > 2 && isAt(points[0])) add(true);
      else if (points.length > 1 && isAt(points[points.length - 1])) add(false);
      else if (!isFree(app.scene.world, ...world)) app.rejectPlace();
      else if (!isAt(points[points.length - 1])) points.push(roundToTenths(world));
    },
    cancel() { const isDrawing = points.length > 0; points = []; here = null; return isDrawing; },
    finish() {
      if (points.length < 2) return this.cancel();
      add(false);
      return true;
    },
    draw(pen, scene, view, { theme }) {
      const path = [...points, ...(here ? [here] : [])];
      path.slice(1).forEach((point, k) => drawLine(pen, view, [path[k], point], theme));
      for (const [x, y] of points) { circle(pen, view, x, y, 4 / view.scale); pen.stroke(); }
    },
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
    cancel() { const isDragging = start !== null; start = null; return isDragging; },
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
      if (index < 0 && !isFree(app.scene.world, ...world)) { app.rejectPlace(); return; }
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
