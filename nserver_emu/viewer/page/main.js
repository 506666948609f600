// Sets up the page: one scene, one connection, the map and the windows. Redraws at most once per frame after changes.

import { emptyScene, applyPicture, changesMap } from './scene.js';
import { readTheme } from './colours.js';
import { openLink } from './link.js';
import { openReplay } from './replay.js';
import { newRun, recordMessage, savePng, saveSvg, saveRun, runLength } from './export.js';
import { mapWindow } from './map_window.js';
import { robotWindow, shortWindow, longWindow } from './robot_windows.js';
import { robotsWindow, robotLabel } from './robots_window.js';
import { driveWindow, poseWindow } from './drive_window.js';
import { timeWindow } from './time_window.js';
import { worldWindow } from './world_window.js';
import { trafficWindow } from './traffic_window.js';
import { learnedMapWindow } from './learned_map_window.js';
import { localizationWindow } from './localization_window.js';
import { setUpTools } from './tools.js';
import { setUpMenus, setUpSharing } from './menus.js';
import { setUpBanner, setUpStopKeys, stop } from './estop.js';
import { newUndoHistory, poseTenths } from './commands.js';
import { isFree } from './geometry.js';
import { button, element } from './widgets.js';
import { takeToken, savePreference, loadPreference } from './browser_storage.js';

// Windows by task. A window has id, title and build(box, app), and may have update(app), onMessage(message, app),
// onToggle(open, app) and reset(); `closed` closes it at first. `acts` hides a task on read-only pages. On a phone one task
// is shown at a time.
const TASKS = {
  drive: { title: 'Drive', acts: true, windows: [driveWindow, poseWindow] },
  world: { title: 'World', acts: true, windows: [worldWindow, timeWindow] },
  localize: { title: 'Localize', windows: [localizationWindow, learnedMapWindow] },
  observe: { title: 'Observe', windows: [robotsWindow, robotWindow, shortWindow, longWindow, trafficWindow] },
};
const WINDOWS = Object.values(TASKS).flatMap(({ windows }) => windows);
// A notice vanishes after this time, except for one that a stop or release has failed.
const NOTICE_MS = 12000;
// Texts need no more than ten updates per second. The server's report of waypoints set here arrives within two seconds.
const WINDOWS_EVERY_MS = 100, JUST_SET_MS = 2000;
const part = (id) => document.getElementById(id);

const unitsListeners = [], waypointsSetAt = {};
const app = {
  scene: emptyScene(), theme: readTheme(), metric: false, robot: '1', mayAct: false, name: '', names: {}, ownRobot: null, token: '', watchToken: null, lines: {},
  selected() { return { id: app.robot, robot: app.scene.robots[app.robot], body: app.scene.bodies[app.robot], scene: app.scene }; },
  onUnits(listener) { unitsListeners.push(listener); },
  switchUnits() {
    app.metric = !app.metric;
    part('units').textContent = app.metric ? 'centimetres' : 'inches';
    part('units').ariaLabel = `Units: ${app.metric ? 'centimetres' : 'inches'}`;
    savePreference('metric', app.metric);
    for (const listener of unitsListeners) listener();
    redrawAll();
  },
  run: newRun(), waypoints: {},
  estimateOf(id) { return localizationWindow.currentEstimate(id); },
  learnedMapOf(id) { return learnedMapWindow.currentMap(id); },
  justSet(id) { return performance.now() - (waypointsSetAt[id] ?? -Infinity) < JUST_SET_MS; },
  setWaypoints(points) {
    storeWaypoints(app.robot, points);
    app.link.send({ do: 'waypoints', robot: Number(app.robot), points });
  },
  selectRobot(id) {
    if (app.robot !== id) driveWindow.release();
    app.robot = id;
    part('robot-choice').value = id;
    app.watch();
    redrawAll();
  },
  givePose(pose) {
    if (!isFree(app.scene.world, pose[0], pose[1])) app.notice('This pose is in a wall, in an obstacle or outside of all rooms; it was sent anyway.');
    app.link.send({ do: 'click', robot: Number(app.robot), pose: poseTenths(pose) });
  },
  // Stop a robot, or all without a number.
  async stop(robot) {
    driveWindow.release();
    app.notice(await stop(app.link, robot), { stays: true });
  },
  stopMine() { return app.stop(Number(app.ownRobot ?? app.robot)); },
  // Close what is open, the newest first, and return false if nothing is. The browser itself closes its menus.
  closeOpen() {
    if (document.querySelector(':popover-open')) return true;
    if (app.toolName !== 'pan') { if (!app.map.tool.cancel?.()) app.chooseTool('pan'); app.map.requestRedraw(); return true; }
    if (part('notice').hidden) return false;
    app.notice('');
    return true;
  },
  requestUpdate() { needsUpdate = true; },
  drawEstimate(pen, scene, view, options) {
    learnedMapWindow.draw(pen, scene, view, options, app);
    localizationWindow.draw(pen, scene, view, options, app);
  },
  // Send the server which optional data this page shows.
  watch() { app.link.send({ do: 'watch', traffic: trafficWindow.open, laser: app.map.shown.laser, robot: Number(app.robot) }); },
  notice(text, { stays = false } = {}) {
    const notice = part('notice');
    notice.firstElementChild.textContent = text;
    notice.hidden = !text;
    clearTimeout(noticeTimer);
    if (text && !stays) noticeTimer = setTimeout(() => app.notice(''), NOTICE_MS);
  },
};
app.history = newUndoHistory(app, () => { needsUpdate = true; });
let needsUpdate = true, windowsUpdatedAt = 0, poseRequests = [], noticeTimer = null;

function redrawAll() {
  app.map.requestRedraw();
  needsUpdate = true;
}

function storeWaypoints(id, points) {
  app.waypoints[id] = points;
  waypointsSetAt[id] = performance.now();
  redrawAll();
}

function onMessage(message, size) {
  if (!window.nserverRun) recordMessage(app.run, message, size);
  switch (message.type) {
    case 'picture': onPicture(message); break;
    case 'hello': onHello(message); break;
    case 'asked': onPoseRequests(message.robots); break;
    case 'waypoints': storeWaypoints(message.robot, message.points); break;
    case 'answer': if (!message.ok) app.notice(message.error); break;
  }
  for (const window of WINDOWS) window.onMessage?.(message, app);
}

function onHello(message) {
  app.mayAct = message.may_act;
  app.name = message.name;
  app.names = message.names ?? {};
  setOwnRobot(message.robot ?? null);
  hasHello = true;
  showConnection();
  app.watchToken = message.watch_token;
  app.lines = message.lines;
  app.ownMethods = message.own_methods;
  app.waypoints = message.waypoints;
  document.body.classList.toggle('read-only', !message.may_act);
  app.watch();
}

// A student's page acts on one robot, which it selects at first; the tasks of the teacher are hidden.
function setOwnRobot(number) {
  const own = number === null ? null : String(number);
  document.body.classList.toggle('student', own !== null);
  if (own !== null && own !== app.ownRobot) app.robot = own;
  app.ownRobot = own;
  // A teacher has the list of the class first.
  if (own === null && Object.keys(app.names).length) { part('windows').prepend(part('task-observe')); part('tasks').prepend(part('show-observe')); }
  if (Object.keys(app.scene.bodies).length) listRobots();
}

// Programs wait for poses of these robots (get_robot_conf): select a robot and the pose tool, and show a message until
// all requests have a reply.
function onPoseRequests(robots) {
  const ids = Object.keys(robots), added = ids.filter((id) => !poseRequests.includes(id));
  const banner = part('pose-request');
  poseRequests = ids;
  banner.hidden = !ids.length || !app.mayAct;
  banner.firstElementChild.textContent = ids.length > 1
    ? `Programs request poses of robots ${ids.join(', ')}: press on the map at the position of the selected robot and drag towards its heading.`
    : `A program requests a pose of robot ${ids[0]}: press on the map at the position and drag towards the heading.`;
  if (added.length && app.mayAct) {
    if (app.scene.robots[added[0]]) app.selectRobot(added[0]);
    app.chooseTool('pose');
  } else if (!ids.length && app.toolName === 'pose') app.chooseTool('pan');
  else if (ids.length && !ids.includes(app.robot) && app.scene.robots[ids[0]]) app.selectRobot(ids[0]);
}

function onPicture(picture) {
  const before = app.scene.world?.name, isChanged = changesMap(app.scene, picture);
  applyPicture(app.scene, picture);
  // Another world is shown as a whole.
  if (before !== undefined && app.scene.world.name !== before) app.map.fitted = false;
  if ('world' in picture) part('world-name').textContent = picture.world.title || picture.world.name;
  if ('bodies' in picture) listRobots();
  updateBanner();
  if (isChanged) app.map.requestRedraw();
  needsUpdate = true;
}

function listRobots() {
  const choice = part('robot-choice'), ids = Object.keys(app.scene.bodies);
  choice.replaceChildren(...ids.map((id) => element('option', { value: id }, `${robotLabel(id, app.names)} (${app.scene.bodies[id].model})`)));
  if (!ids.includes(app.robot)) { app.robot = ids[0]; app.watch(); }
  choice.value = app.robot;
}

function clockText({ time_s, speed, paused, lockstep_s }) {
  const rate = paused ? 'paused' : lockstep_s !== null ? 'in lockstep' : speed === null ? 'as fast as possible' : `${speed} x`;
  return `${time_s.toFixed(1)} s, ${rate}`;
}

function frame(now) {
  app.map.frame();
  if (needsUpdate && now - windowsUpdatedAt >= WINDOWS_EVERY_MS) {
    needsUpdate = false;
    windowsUpdatedAt = now;
    part('clock').textContent = clockText(app.scene);
    for (const window of WINDOWS) if (window.box.parentElement.open) window.update(app);
  }
  requestAnimationFrame(frame);
}

function buildWindows() {
  for (const [name, { title, acts, windows }] of Object.entries(TASKS)) {
    const section = element('section', { className: `task${acts ? ' acts' : ''}`, id: `task-${name}`, ariaLabel: title }, element('h2', {}, title));
    part('windows').append(section);
    for (const window of windows) buildWindow(window, section);
    part('tasks').append(button(title, () => chooseTask(name), { id: `show-${name}`, className: acts ? 'acts' : '' }));
  }
  chooseTask(loadPreference('task', 'localize'));
}

function buildWindow(window, section) {
  window.box = element('div');
  const details = element('details', { className: 'window', open: loadPreference(`window ${window.id}`, !window.closed), id: `window-${window.id}` },
    element('summary', {}, window.title), window.box);
  details.addEventListener('toggle', () => { savePreference(`window ${window.id}`, details.open); needsUpdate = true; window.onToggle?.(details.open, app); });
  section.append(details);
  window.build(window.box, app);
}

// Select the task that a phone shows; the window of a task that has only closed ones is opened.
function chooseTask(name) {
  for (const task of Object.keys(TASKS)) {
    part(`task-${task}`).classList.toggle('chosen', task === name);
    part(`show-${task}`).setAttribute('aria-current', String(task === name));
  }
  savePreference('task', name);
  needsUpdate = true;
}

function undoByKey(event) {
  const key = event.key.toLowerCase();
  if (!(event.ctrlKey || event.metaKey) || event.target.closest?.('input, textarea') || !['z', 'y'].includes(key)) return;
  event.preventDefault();
  if (key === 'y' || event.shiftKey) app.history.redo(); else app.history.undo();
}

buildWindows();
app.map = mapWindow(app);
setUpTools(app);
if (loadPreference('metric', false)) app.switchUnits();
setUpMenus();
setUpSharing(app);
const updateBanner = setUpBanner(app);
// The buttons of index.html; those of a window are made by the window.
const ON_CLICK = {
  stop: () => app.stopMine(), 'stop-all': () => app.stop(),
  'notice-close': () => app.notice(''),
  'pose-here': () => { if (app.scene.robots[app.robot]) app.givePose(app.scene.robots[app.robot].actual); },
  'clear-traces': () => { app.scene.traces = {}; app.map.requestRedraw(); },
  'save-png': () => savePng(app), 'save-svg': () => saveSvg(app), 'save-run': () => saveRun(app),
};
for (const [id, action] of Object.entries(ON_CLICK)) part(id).addEventListener('click', action);
part('robot-choice').addEventListener('change', (event) => app.selectRobot(event.target.value));
part('save').addEventListener('beforetoggle', () => { part('save-run').textContent = `Run (HTML), ${runLength(app.run)}`; });
for (const query of ['(prefers-color-scheme: dark)', '(prefers-contrast: more)']) {
  matchMedia(query).addEventListener('change', () => { app.theme = readTheme(); redrawAll(); });
}
setInterval(() => { redrawAll(); showConnection(); }, 1000);  // ages of data grow without messages

const CONNECTION_TEXTS = { live: 'live', lost: 'connection lost: reconnecting',
  rejected: 'nserver was restarted: open the address that it printed',
  'no-token': 'token missing: open the full address that nserver printed', replay: 'saved run' };
let connection = '', lostAt = 0, hasHello = false;
function onState(name) {
  if (name === 'lost' && connection === 'live') lostAt = performance.now();
  connection = name;
  document.body.classList.toggle('lost', ['lost', 'rejected', 'no-token'].includes(name));
  showConnection();
}

function showConnection() {
  const age = connection === 'lost' && lostAt ? `, last message ${Math.round((performance.now() - lostAt) / 1000)} s ago` : '';
  const access = connection === 'live' && hasHello && !app.mayAct ? ', read-only' : '';
  part('link-state').textContent = `${CONNECTION_TEXTS[connection] ?? ''}${access}${age}`;
}

function onReset() {
  app.scene = emptyScene();
  app.waypoints = {};
  for (const window of WINDOWS) window.reset?.();
}

if (window.nserverRun) {
  document.body.classList.add('read-only', 'replays');
  document.title = 'Nserver: saved run';
  app.run = window.nserverRun;
  app.link = openReplay(window.nserverRun, { onMessage, onState, onReset });
} else {
  setUpStopKeys({ closeOpen: app.closeOpen, stopMine: () => { if (app.mayAct) app.stopMine(); },
    stopAll: () => { if (app.mayAct) app.stop(); } });
  document.addEventListener('keydown', undoByKey);
  app.token = takeToken();
  app.link = openLink(app.token, { onMessage, onState });
}
requestAnimationFrame(frame);
window.nserver = app;
