// The map: a canvas over a view, redrawn when something changed; pan, zoom, follow, keys. What a pointer does beyond
// panning is the tool's in force (tools.js).

import { newView, toScreen, toWorld, zoomAt, pan, fitTo } from './view.js';
import { worldBounds } from './scene.js';
import { drawScene, drawGraphics, LAYERS } from './draw.js';
import { sizedPen, element } from './parts.js';
import { lengthText } from './units.js';
import { remember, remembered } from './remembering.js';

const ZOOM = 1.25, KEY_PAN_PX = 40;
const NOTES = { laser: 'Of the robot that is chosen, while any of its clients has it on: the window Robot says whose',
  sonar: 'Of the robot that is chosen, from where each sonar cried' };

export function mapWindow(app) {
  const canvas = document.getElementById('map');
  const sheet = document.createElement('canvas');
  const view = newView();
  const shown = Object.fromEntries(Object.keys(LAYERS).map((name) => [name, remembered(`layer ${name}`, true)]));
  const map = { canvas, view, shown, following: false, fitted: false, tool: null, draw, keepDrawing, fit, options };
  const pointers = new Map();
  let pinch = 0, dirty = true, pressed = null;

  function options() {
    return { theme: app.theme, metric: app.metric, shown, robot: app.robot, graphics: stampGraphics,
      estimate: app.drawEstimate, tool: map.tool?.draw?.bind(map.tool) };
  }

  function stampGraphics(pen, scene) {
    if (!scene.graphics.length) return;
    const density = window.devicePixelRatio || 1;
    sheet.width = Math.round(view.width * density);
    sheet.height = Math.round(view.height * density);
    const under = sheet.getContext('2d');
    under.setTransform(density, 0, 0, density, 0, 0);
    drawGraphics(under, scene, view, { theme: app.theme });
    pen.drawImage(sheet, 0, 0, view.width, view.height);
  }

  function draw() {
    const pen = sizedPen(canvas);
    if (!pen) return;
    view.width = pen.width;
    view.height = pen.height;
    if (!map.fitted && app.scene.world) { fit(); map.fitted = true; }
    const robot = app.scene.robots[app.robot];
    if (map.following && robot) [view.x, view.y] = robot.actual;
    drawScene(pen, app.scene, view, options());
  }

  function keepDrawing() { dirty = true; }

  function fit() { fitTo(view, worldBounds(app.scene)); keepDrawing(); }

  function fitAll() { if (map.following) follow(false); fit(); }

  function follow(on) {
    map.following = on;
    document.getElementById('follow').setAttribute('aria-pressed', String(on));
    keepDrawing();
  }

  function zoom(factor) { zoomAt(view, factor, view.width / 2, view.height / 2); keepDrawing(); }

  function place(event) {
    const box = canvas.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  }

  canvas.addEventListener('wheel', (event) => {
    event.preventDefault();
    zoomAt(view, ZOOM ** (-event.deltaY / 100), ...place(event));
    keepDrawing();
  }, { passive: false });

  canvas.addEventListener('pointerdown', (event) => {
    canvas.focus({ preventScroll: true });
    canvas.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, place(event));
    pressed = pointers.size === 1 ? [event.clientX, event.clientY] : null;
    if (pointers.size === 1) map.dragged = map.tool?.down?.(toWorld(view, ...place(event)), event) ? 'tool' : 'map';
    else { if (map.dragged === 'tool') map.tool.cancel?.(); map.dragged = 'map'; pinch = spread(); }
    keepDrawing();
  });

  canvas.addEventListener('pointermove', (event) => {
    const here = place(event), world = toWorld(view, ...here), before = pointers.get(event.pointerId);
    document.getElementById('pointer').textContent =
      `${lengthText(world[0], app.metric)}, ${lengthText(world[1], app.metric)}`;
    if (!before) return;
    pointers.set(event.pointerId, here);
    if (map.dragged === 'tool') map.tool.move?.(world, event);
    else {
      if (map.following) follow(false);
      pan(view, (here[0] - before[0]) / pointers.size, (here[1] - before[1]) / pointers.size);
      if (pointers.size === 2) { const now = spread(); zoomAt(view, now / (pinch || now), ...here); pinch = now; }
    }
    keepDrawing();
  });

  function spread() {
    const [[x1, y1], [x2, y2]] = [...pointers.values()];
    return Math.hypot(x2 - x1, y2 - y1);
  }

  function release(event) {
    if (!pointers.delete(event.pointerId) || pointers.size) return;
    if (map.dragged === 'tool') {
      if (event.type === 'pointerup') map.tool.up?.(toWorld(view, ...place(event)), event);
      else map.tool.cancel?.();
    } else if (event.type === 'pointerup' && pressed && Math.hypot(event.clientX - pressed[0], event.clientY - pressed[1]) < 4) {
      map.tool?.tap?.(toWorld(view, ...place(event)));
    }
    pressed = null;
    map.dragged = null;
    keepDrawing();
  }
  canvas.addEventListener('pointerup', release);
  canvas.addEventListener('pointercancel', release);

  const move = (dx, dy) => () => { if (map.following) follow(false); pan(view, dx, dy); };
  const keys = {
    '+': () => zoom(ZOOM), '=': () => zoom(ZOOM), '-': () => zoom(1 / ZOOM), 0: fitAll, f: () => follow(!map.following),
    u: () => app.switchUnits(),
    arrowleft: move(KEY_PAN_PX, 0), arrowright: move(-KEY_PAN_PX, 0), arrowup: move(0, KEY_PAN_PX), arrowdown: move(0, -KEY_PAN_PX),
    escape: () => map.tool?.cancel?.(),
  };
  canvas.addEventListener('keydown', (event) => {
    const act = keys[event.key.toLowerCase()];
    if (!act || event.ctrlKey || event.metaKey || event.altKey || event.defaultPrevented) return;
    act();
    event.preventDefault();
    keepDrawing();
  });

  for (const [id, press] of [['zoom-in', () => zoom(ZOOM)], ['zoom-out', () => zoom(1 / ZOOM)], ['fit', fitAll],
    ['follow', () => follow(!map.following)], ['units', () => app.switchUnits()]]) {
    document.getElementById(id).addEventListener('click', press);
  }
  for (const [name, title] of Object.entries(LAYERS)) {
    const box = element('input', { type: 'checkbox', checked: shown[name], id: `layer-${name}`, onchange: () => {
      shown[name] = box.checked;
      remember(`layer ${name}`, box.checked);
      app.layersChanged();
      keepDrawing();
    } });
    const label = element('label', { title: NOTES[name] ?? '' }, box, ` ${title}`);
    document.getElementById('clear-traces').before(label);
  }
  new ResizeObserver(keepDrawing).observe(canvas);

  map.frame = () => { if (dirty) { dirty = false; draw(); } };
  map.screenOf = (x, y) => toScreen(view, x, y);
  map.pixels = ([x1, y1], [x2, y2]) => Math.hypot(x2 - x1, y2 - y1) * view.scale;
  return map;
}
