// Puts the page together: one scene, one link, the map and the windows; draws once a frame when something is new.

import { emptyScene, applyPicture } from './scene.js';
import { readTheme } from './colours.js';
import { openLink } from './link.js';
import { takeToken } from './entrance.js';
import { openReplay } from './replay.js';
import { newRun, keepMessage, savePng, saveSvg, saveRun, runLength } from './keeping.js';
import { mapWindow } from './map_window.js';
import { robotWindow, shortWindow, longWindow } from './robot_windows.js';
import { driveWindow } from './drive_window.js';
import { timeWindow } from './time_window.js';
import { worldWindow } from './world_window.js';
import { trafficWindow } from './traffic_window.js';
import { localizationWindow } from './localization_window.js';
import { setUpTools } from './tools.js';
import { setUpMenus } from './menus.js';
import { setUpSharing } from './share.js';
import { setUpHolding } from './holding.js';
import { setUpStopping, stopAll } from './stopping.js';
import { newUndo } from './undo.js';
import { tenthsOf, angleTenths } from './units.js';
import { isFree } from './ground.js';
import { element } from './parts.js';
import { remember, remembered } from './remembering.js';

const WINDOWS = [driveWindow, robotWindow, shortWindow, longWindow, localizationWindow, timeWindow, worldWindow, trafficWindow];
const WINDOWS_EVERY_MS = 100, JUST_SET_MS = 2000;
const part = (id) => document.getElementById(id);

const unitsListeners = [], setAt = {};
const app = {
  scene: emptyScene(), theme: readTheme(), metric: false, robot: '1', mayAct: false, name: '', token: '', watchToken: null, lines: {},
  chosen() { return { id: app.robot, robot: app.scene.robots[app.robot], body: app.scene.bodies[app.robot], scene: app.scene }; },
  onUnits(listener) { unitsListeners.push(listener); },
  switchUnits() {
    app.metric = !app.metric;
    part('units').textContent = app.metric ? 'centimetres' : 'inches';
    part('units').ariaLabel = `Units: ${app.metric ? 'centimetres' : 'inches'}`;
    remember('metric', app.metric);
    for (const listener of unitsListeners) listener();
    app.map.keepDrawing();
    refresh = true;
  },
  run: newRun(), waypoints: {},
  estimateOf(id) { return localizationWindow.alive(id); },
  justSet(id) { return performance.now() - (setAt[id] ?? -Infinity) < JUST_SET_MS; },
  setWaypoints(points) {
    app.waypoints[app.robot] = points;
    setAt[app.robot] = performance.now();
    app.link.send({ do: 'waypoints', robot: Number(app.robot), points });
    app.map.keepDrawing();
    refresh = true;
  },
  selectRobot(id) {
    if (app.robot !== id) driveWindow.release();
    app.robot = id;
    part('robot-choice').value = id;
    app.watch();
    app.map.keepDrawing();
    refresh = true;
  },
  givePose([x, y, steer, turret]) {
    if (!isFree(app.scene.world, x, y)) app.notice('That pose stands in a wall, in an obstacle or outside; it was given as it is.');
    app.link.send({ do: 'click', robot: Number(app.robot), pose: [tenthsOf(x), tenthsOf(y), angleTenths(steer), angleTenths(turret)] });
  },
  async stopAll() {
    driveWindow.release();
    app.notice(await stopAll(app.link));
  },
  changed() { refresh = true; },
  drawEstimate(pen, scene, view, options) { localizationWindow.draw(pen, scene, view, options, app); },
  layersChanged() { app.watch(); },
  watch() { app.link.send({ do: 'watch', traffic: trafficWindow.open, laser: app.map.shown.laser, robot: Number(app.robot) }); },
  notice(text) {
    const place = part('notice');
    place.firstElementChild.textContent = text;
    place.hidden = !text;
  },
};
app.undo = newUndo(app, () => { refresh = true; });
let refresh = true, windowsDrawn = 0, asked = [];

function hear(message, size) {
  if (!window.nserverRun) keepMessage(app.run, message, size);
  if (message.type === 'picture') takePicture(message);
  else if (message.type === 'hello') greet(message);
  else if (message.type === 'asked') showAsked(message.robots);
  else if (message.type === 'waypoints') { app.waypoints[message.robot] = message.points; setAt[message.robot] = performance.now(); app.map.keepDrawing(); refresh = true; }
  else if (message.type === 'answer' && !message.ok) app.notice(message.error);
  for (const window of WINDOWS) window.hear?.(message, app);
}

function greet(message) {
  app.mayAct = message.may_act;
  app.name = message.name;
  greeted = true;
  tellState();
  app.watchToken = message.watch_token;
  app.lines = message.lines;
  app.waypoints = message.waypoints;
  document.body.classList.toggle('only-looks', !message.may_act);
  app.watch();
}

// A client waits for a pose: said for as long as it waits; its robot is chosen, and the tool that gives one.
function showAsked(robots) {
  const ids = Object.keys(robots), fresh = ids.filter((id) => !asked.includes(id));
  const place = part('asked');
  asked = ids;
  place.hidden = !ids.length || !app.mayAct;
  place.firstElementChild.textContent = ids.length > 1
    ? `Programs ask for poses of robots ${ids.join(', ')}: press on the map and drag to where the one that is chosen heads.`
    : `A program asks for a pose of robot ${ids[0]}: press on the map and drag to where it heads.`;
  if (fresh.length && app.mayAct) {
    if (app.scene.robots[fresh[0]]) app.selectRobot(fresh[0]);
    app.choose('pose');
  } else if (!ids.length && app.toolName === 'pose') app.choose('pan');
  else if (ids.length && !ids.includes(app.robot) && app.scene.robots[ids[0]]) app.selectRobot(ids[0]);
}

function takePicture(picture) {
  applyPicture(app.scene, picture);
  if ('world' in picture) part('world-name').textContent = picture.world.title || picture.world.name;
  if ('bodies' in picture) offerRobots();
  showHeld();
  app.map.keepDrawing();
  refresh = true;
}

function offerRobots() {
  const choice = part('robot-choice'), ids = Object.keys(app.scene.bodies);
  choice.replaceChildren(...ids.map((id) => element('option', { value: id }, `${id} (${app.scene.bodies[id].model})`)));
  if (!ids.includes(app.robot)) { app.robot = ids[0]; app.watch(); }
  choice.value = app.robot;
}

function clockText({ time_s, speed, paused, lockstep_s }) {
  const pace = paused ? 'paused' : lockstep_s !== null ? 'in lockstep' : speed === null ? 'as fast as it can' : `${speed} x`;
  return `${time_s.toFixed(1)} s, ${pace}`;
}

function frame(now) {
  app.map.frame();
  if (refresh && now - windowsDrawn >= WINDOWS_EVERY_MS) {
    refresh = false;
    windowsDrawn = now;
    part('clock').textContent = clockText(app.scene);
    for (const window of WINDOWS) if (window.box.parentElement.open) window.update(app);
  }
  requestAnimationFrame(frame);
}

function buildWindows() {
  for (const window of WINDOWS) {
    window.box = element('div');
    const whole = element('details', { className: `window${window.acts ? ' acts' : ''}`, open: remembered(`window ${window.id}`, !window.closed), id: `window-${window.id}` },
      element('summary', {}, window.title), window.box);
    whole.addEventListener('toggle', () => { remember(`window ${window.id}`, whole.open); refresh = true; window.toggled?.(whole.open, app); });
    part('windows').append(whole);
    window.build(window.box, app);
  }
}

function undoByKey(event) {
  const key = event.key.toLowerCase();
  if (!(event.ctrlKey || event.metaKey) || event.target.closest?.('input, textarea') || !['z', 'y'].includes(key)) return;
  event.preventDefault();
  if (key === 'y' || event.shiftKey) app.undo.redo(); else app.undo.undo();
}

buildWindows();
app.map = mapWindow(app);
setUpTools(app);
if (remembered('metric', false)) app.switchUnits();
setUpMenus();
setUpSharing(app);
const showHeld = setUpHolding(app);
part('robot-choice').addEventListener('change', (event) => app.selectRobot(event.target.value));
part('stop').addEventListener('click', () => app.stopAll());
part('notice-close').addEventListener('click', () => app.notice(''));
part('asked-here').addEventListener('click', () => { if (app.scene.robots[app.robot]) app.givePose(app.scene.robots[app.robot].actual); });
part('keep').addEventListener('beforetoggle', () => { part('save-run').textContent = `Run (HTML), ${runLength(app.run)}`; });
part('clear-traces').addEventListener('click', () => { app.scene.traces = {}; app.map.keepDrawing(); });
for (const query of ['(prefers-color-scheme: dark)', '(prefers-contrast: more)']) {
  matchMedia(query).addEventListener('change', () => { app.theme = readTheme(); app.map.keepDrawing(); refresh = true; });
}
for (const [id, keep] of [['save-png', savePng], ['save-svg', saveSvg], ['save-run', saveRun]]) part(id).addEventListener('click', () => keep(app));
setInterval(() => { refresh = true; tellState(); }, 1000);  // what grows old is shown so though nothing comes

const STATES = { live: 'live', lost: 'connection lost: trying again',
  refused: 'nserver was started anew: open the address that it printed now',
  closed: 'no way in without a token: open the whole address that nserver printed', replay: 'a run that was kept' };
let state = '', lostAt = 0, greeted = false;
function showState(name) {
  if (name === 'lost' && state === 'live') lostAt = performance.now();
  state = name;
  document.body.classList.toggle('lost', ['lost', 'refused', 'closed'].includes(name));
  tellState();
}

function tellState() {
  const ago = state === 'lost' && lostAt ? `, last heard ${Math.round((performance.now() - lostAt) / 1000)} s ago` : '';
  part('link-state').textContent = `${STATES[state] ?? ''}${state === 'live' && greeted && !app.mayAct ? ', only looking' : ''}${ago}`;
}

function beginAnew() {
  app.scene = emptyScene();
  app.waypoints = {};
  for (const window of WINDOWS) window.reset?.();
}

if (window.nserverRun) {
  document.body.classList.add('only-looks', 'replays');
  document.title = 'Nserver: a run that was kept';
  app.run = window.nserverRun;
  app.link = openReplay(window.nserverRun, { hear, state: showState, reset: beginAnew });
} else {
  setUpStopping(() => { if (app.mayAct) app.stopAll(); });
  document.addEventListener('keydown', undoByKey);
  app.token = takeToken();
  app.link = openLink(app.token, { hear, state: showState });
}
requestAnimationFrame(frame);
window.nserver = app;
