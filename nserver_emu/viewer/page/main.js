// Puts the page together: one scene, one link, the map and the windows; draws once a frame when something is new.

import { emptyScene, applyPicture } from './scene.js';
import { readTheme } from './colours.js';
import { openLink } from './link.js';
import { openReplay } from './replay.js';
import { newRun, keepMessage, savePng, saveSvg, saveRun } from './keeping.js';
import { mapWindow } from './map_window.js';
import { robotWindow, shortWindow, longWindow } from './robot_windows.js';
import { driveWindow, timeWindow, worldWindow } from './doing_windows.js';
import { trafficWindow } from './traffic_window.js';
import { localizationWindow } from './localization_window.js';
import { setUpTools, drawWaypoints } from './tools.js';
import { setUpMenus } from './menus.js';
import { tenthsOf, angleTenths } from './units.js';
import { element } from './parts.js';

const WINDOWS = [driveWindow, robotWindow, shortWindow, longWindow, localizationWindow, timeWindow, worldWindow, trafficWindow];
const MOST_UNDO = 200;
const WINDOWS_EVERY_MS = 100;

const app = {
  scene: emptyScene(), theme: readTheme(), metric: false, robot: '1', mayAct: false, watchToken: null,
  chosen() { return { id: app.robot, robot: app.scene.robots[app.robot], body: app.scene.bodies[app.robot], scene: app.scene }; },
  switchUnits() {
    app.metric = !app.metric;
    document.getElementById('units').textContent = app.metric ? 'centimetres' : 'inches';
    app.map.keepDrawing();
    refresh = true;
  },
  undo: { steps: [], push(step) { this.steps.push(step); if (this.steps.length > MOST_UNDO) this.steps.shift(); }, pop() { return this.steps.pop(); } },
  run: newRun(), waypoints: [],
  waypointsChanged() { app.link.send({ do: 'waypoints', points: app.waypoints }); app.map.keepDrawing(); },
  selectRobot(id) {
    if (app.robot !== id) driveWindow.release();
    app.robot = id;
    document.getElementById('robot-choice').value = id;
    app.map.keepDrawing();
    refresh = true;
  },
  givePose([x, y, steer, turret]) {
    app.link.send({ do: 'click', robot: Number(app.robot), pose: [tenthsOf(x), tenthsOf(y), angleTenths(steer), angleTenths(turret)] });
  },
  stopAll() {
    driveWindow.release();
    for (const id of Object.keys(app.scene.robots)) app.link.ask({ do: 'call', robot: Number(id), call: 'st', args: [] });
  },
  changed() { refresh = true; },
  drawEstimate(pen, scene, view, options) {
    if (app.waypoints.length && !localizationWindow.latest) drawWaypoints(pen, app.waypoints, view, options.theme);
    localizationWindow.draw(pen, scene, view, options);
  },
  layersChanged() { watch(); },
  watch() { watch(); },
  notice(text) {
    const place = document.getElementById('notice');
    place.textContent = text;
    place.hidden = !text;
  },
};
let refresh = true, windowsDrawn = 0;

function hear(message) {
  if (!window.nserverRun) keepMessage(app.run, message);
  if (message.type === 'picture') takePicture(message);
  else if (message.type === 'hello') greet(message);
  else if (message.type === 'asked') showAsked(message.robots);
  else if (message.type === 'waypoints') { app.waypoints = message.points; app.map.keepDrawing(); }
  else if (message.type === 'answer' && !message.ok) app.notice(message.error);
  for (const window of WINDOWS) window.hear?.(message, app);
}

function greet(message) {
  app.mayAct = message.may_act;
  app.watchToken = message.watch_token;
  document.body.classList.toggle('only-looks', !message.may_act);
  app.scene = emptyScene();
  watch();
}

// A client waits for a pose: say so, choose its robot and the tool that gives one; back to the map when it is given.
function showAsked(robots) {
  const ids = Object.keys(robots);
  app.asked = ids;
  if (ids.length && app.mayAct) {
    app.notice(`A program asks for a pose of robot ${ids[0]}: press on the map and drag to where it heads.`);
    if (app.scene.robots[ids[0]]) app.selectRobot(ids[0]);
    app.choose('pose');
  } else if (app.toolName === 'pose') { app.notice(''); app.choose('pan'); }
}

function watch() { app.link.send({ do: 'watch', traffic: trafficWindow.open, laser: app.map.shown.laser }); }

function takePicture(picture) {
  applyPicture(app.scene, picture);
  if ('world' in picture) document.getElementById('world-name').textContent = picture.world.title || picture.world.name;
  if ('bodies' in picture) offerRobots();
  app.map.keepDrawing();
  refresh = true;
}

function offerRobots() {
  const choice = document.getElementById('robot-choice'), ids = Object.keys(app.scene.bodies);
  choice.replaceChildren(...ids.map((id) => element('option', { value: id }, `${id} (${app.scene.bodies[id].model})`)));
  if (!ids.includes(app.robot)) app.robot = ids[0];
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
    document.getElementById('clock').textContent = clockText(app.scene);
    for (const window of WINDOWS) if (window.box.parentElement.open) window.update(app);
  }
  requestAnimationFrame(frame);
}

function buildWindows() {
  for (const window of WINDOWS) {
    window.box = element('div');
    const whole = element('details', { className: `window${window.acts ? ' acts' : ''}`, open: !window.closed, id: `window-${window.id}` },
      element('summary', {}, window.title), window.box);
    whole.addEventListener('toggle', () => { refresh = true; window.toggled?.(whole.open, app); });
    document.getElementById('windows').append(whole);
    window.build(window.box, app);
  }
}

buildWindows();
app.map = mapWindow(app);
setUpTools(app);
setUpMenus();
document.getElementById('robot-choice').addEventListener('change', (event) => app.selectRobot(event.target.value));
document.getElementById('stop').addEventListener('click', () => app.stopAll());
document.addEventListener('keydown', (event) => {
  if (event.key !== ' ' || event.target.closest('button, input, textarea, select, summary')) return;
  event.preventDefault();
  app.stopAll();
});
for (const query of ['(prefers-color-scheme: dark)', '(prefers-contrast: more)']) {
  matchMedia(query).addEventListener('change', () => { app.theme = readTheme(); app.map.keepDrawing(); refresh = true; });
}
for (const [id, keep] of [['save-png', savePng], ['save-svg', saveSvg], ['save-run', saveRun]]) {
  document.getElementById(id).addEventListener('click', () => keep(app));
}

const STATES = { live: 'live', lost: 'connection lost: trying again', replay: 'a run that was kept' };
function showState(name) {
  const place = document.getElementById('link-state');
  place.textContent = STATES[name];
  place.classList.toggle('lost', name === 'lost');
}

if (window.nserverRun) {
  document.body.classList.add('only-looks', 'replays');
  app.run = window.nserverRun;
  app.link = openReplay(window.nserverRun, { hear, state: showState, reset() { app.scene = emptyScene(); } });
} else {
  app.link = openLink(new URLSearchParams(location.search).get('token') ?? '', { hear, state: showState });
}
requestAnimationFrame(frame);
window.nserver = app;
