// The map: a canvas that shows the scene through a view, with pan, zoom, follow and keys. Drags that the active tool
// (tools.js) does not handle move the map.

import { newView, toScreen, toWorld, zoomAt, pan, fitTo } from './geometry.js';
import { worldBounds } from './scene.js';
import { drawScene, drawGraphics, LAYERS } from './draw.js';
import { sizedPen, element } from './widgets.js';
import { lengthText } from './units.js';
import { savePreference, loadPreference } from './browser_storage.js';

const ZOOM = 1.25, KEY_PAN_PX = 40, MAX_TAP_PX = 4;
const NOTES = { laser: 'Points of the selected robot while any of its clients has the laser on; the window Robot lists the clients',
  sonar: 'Beams of the selected robot, each from the position of its ping' };

export function mapWindow(app) {
  const canvas = document.getElementById('map');
  const layer = document.createElement('canvas');
  const view = newView();
  const shown = Object.fromEntries(Object.keys(LAYERS).map((name) => [name, loadPreference(`layer ${name}`, true)]));
  const map = { canvas, view, shown, following: false, fitted: false, tool: null, draw, requestRedraw, fit, options };
  const pointers = new Map();  // positions of the pressed pointers: two fingers zoom
  let fingerDistance = 0, isDirty = true, pressedAt = null;

  function options() {
    return { theme: app.theme, metric: app.metric, shown, robot: app.robot, names: app.names, graphics: drawClientGraphics,
      estimate: app.drawEstimate, tool: map.tool?.draw?.bind(map.tool) };
  }

  // Client graphics need a canvas of their own for XOR.
  function drawClientGraphics(pen, scene) {
    if (!scene.graphics.length) return;
    const density = window.devicePixelRatio || 1;
    layer.width = Math.round(view.width * density);
    layer.height = Math.round(view.height * density);
    const layerPen = layer.getContext('2d');
    layerPen.setTransform(density, 0, 0, density, 0, 0);
    drawGraphics(layerPen, scene, view, { theme: app.theme });
    pen.drawImage(layer, 0, 0, view.width, view.height);
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

  function requestRedraw() { isDirty = true; }

  function fit() { fitTo(view, worldBounds(app.scene)); requestRedraw(); }

  function fitAll() { if (map.following) follow(false); fit(); }

  function follow(on) {
    map.following = on;
    document.getElementById('follow').setAttribute('aria-pressed', String(on));
    requestRedraw();
  }

  function zoom(factor) { zoomAt(view, factor, view.width / 2, view.height / 2); requestRedraw(); }

  function position(event) {
    const box = canvas.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  }

  canvas.addEventListener('wheel', (event) => {
    event.preventDefault();
    zoomAt(view, ZOOM ** (-event.deltaY / 100), ...position(event));
    requestRedraw();
  }, { passive: false });

  canvas.addEventListener('pointerdown', (event) => {
    canvas.focus({ preventScroll: true });
    canvas.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, position(event));
    pressedAt = pointers.size === 1 ? [event.clientX, event.clientY] : null;
    if (pointers.size === 1) map.dragged = map.tool?.down?.(toWorld(view, ...position(event)), event) ? 'tool' : 'map';
    else { if (map.dragged === 'tool') map.tool.cancel?.(); map.dragged = 'map'; fingerDistance = pointerDistance(); }
    requestRedraw();
  });

  canvas.addEventListener('pointermove', (event) => {
    const here = position(event), world = toWorld(view, ...here), before = pointers.get(event.pointerId);
    document.getElementById('pointer').textContent =
      `${lengthText(world[0], app.metric)}, ${lengthText(world[1], app.metric)}`;
    if (!before) return;
    pointers.set(event.pointerId, here);
    if (map.dragged === 'tool') map.tool.move?.(world, event);
    else {
      if (map.following) follow(false);
      pan(view, (here[0] - before[0]) / pointers.size, (here[1] - before[1]) / pointers.size);
      if (pointers.size === 2) { const now = pointerDistance(); zoomAt(view, now / (fingerDistance || now), ...here); fingerDistance = now; }
    }
    requestRedraw();
  });

  function pointerDistance() {
    const [[x1, y1], [x2, y2]] = [...pointers.values()];
    return Math.hypot(x2 - x1, y2 - y1);
  }

  function release(event) {
    if (!pointers.delete(event.pointerId) || pointers.size) return;
    if (map.dragged === 'tool') {
      if (event.type === 'pointerup') map.tool.up?.(toWorld(view, ...position(event)), event);
      else map.tool.cancel?.();
    } else if (event.type === 'pointerup' && pressedAt && Math.hypot(event.clientX - pressedAt[0], event.clientY - pressedAt[1]) < MAX_TAP_PX) {
      if (map.tool?.tap) map.tool.tap(toWorld(view, ...position(event)));
      else app.rejectPlace();
    }
    pressedAt = null;
    map.dragged = null;
    requestRedraw();
  }
  canvas.addEventListener('pointerup', release);
  canvas.addEventListener('pointercancel', release);

  const move = (dx, dy) => () => { if (map.following) follow(false); pan(view, dx, dy); };
  const keys = {
    '+': () => zoom(ZOOM), '=': () => zoom(ZOOM), '-': () => zoom(1 / ZOOM), 0: fitAll, f: () => follow(!map.following),
    u: () => app.switchUnits(),
    arrowleft: move(KEY_PAN_PX, 0), arrowright: move(-KEY_PAN_PX, 0), arrowup: move(0, KEY_PAN_PX), arrowdown: move(0, -KEY_PAN_PX),
  };
  canvas.addEventListener('keydown', (event) => {
    const action = keys[event.key.toLowerCase()];
    if (!action || event.ctrlKey || event.metaKey || event.altKey || event.defaultPrevented) return;
    action();
    event.preventDefault();
    requestRedraw();
  });

  for (const [id, action] of [['zoom-in', () => zoom(ZOOM)], ['zoom-out', () => zoom(1 / ZOOM)], ['fit', fitAll],
    ['follow', () => follow(!map.following)], ['units', () => app.switchUnits()]]) {
    document.getElementById(id).addEventListener('click', action);
  }
  for (const [name, title] of Object.entries(LAYERS)) {
    const box = element('input', { type: 'checkbox', checked: shown[name], id: `layer-${name}`, onchange: () => {
      shown[name] = box.checked;
      savePreference(`layer ${name}`, box.checked);
      app.watch();
      requestRedraw();
    } });
    const label = element('label', { title: NOTES[name] ?? '' }, box, ` ${title}`);
    document.getElementById('clear-traces').before(label);
  }
  new ResizeObserver(requestRedraw).observe(canvas);

  map.frame = () => { if (isDirty) { isDirty = false; draw(); } };
  map.screenOf = (x, y) => toScreen(view, x, y);
  map.pixels = ([x1, y1], [x2, y2]) => Math.hypot(x2 - x1, y2 - y1) * view.scale;
  return map;
}
