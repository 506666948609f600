// Puts the page together: one scene, one link, the map and the windows; draws once a frame when something is new.

import { emptyScene, applyPicture } from './scene.js';
import { readTheme } from './colours.js';
import { openLink } from './link.js';
import { mapWindow } from './map_window.js';
import { robotWindow, shortWindow, longWindow } from './robot_windows.js';
import { element } from './parts.js';

const WINDOWS = [robotWindow, shortWindow, longWindow];
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
  layersChanged() { watch(); },
  notice(text) {
    const place = document.getElementById('notice');
    place.textContent = text;
    place.hidden = !text;
  },
};
let refresh = true, windowsDrawn = 0;

function hear(message) {
  if (message.type === 'picture') takePicture(message);
  else if (message.type === 'hello') greet(message);
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

function watch() { app.link.send({ do: 'watch', traffic: false, laser: app.map.shown.laser }); }

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
    const whole = element('details', { className: `window${window.acts ? ' acts' : ''}`, open: true, id: `window-${window.id}` },
      element('summary', {}, window.title), window.box);
    whole.addEventListener('toggle', () => { refresh = true; });
    document.getElementById('windows').append(whole);
    window.build(window.box, app);
  }
}

buildWindows();
app.map = mapWindow(app);
document.getElementById('robot-choice').addEventListener('change', (event) => {
  app.robot = event.target.value;
  app.map.keepDrawing();
  refresh = true;
});
for (const query of ['(prefers-color-scheme: dark)', '(prefers-contrast: more)']) {
  matchMedia(query).addEventListener('change', () => { app.theme = readTheme(); app.map.keepDrawing(); refresh = true; });
}
app.link = openLink(new URLSearchParams(location.search).get('token') ?? '', {
  hear,
  state(name) {
    const place = document.getElementById('link-state');
    place.textContent = name === 'live' ? 'live' : 'connection lost: trying again';
    place.classList.toggle('lost', name !== 'live');
  },
});
requestAnimationFrame(frame);
window.nserver = app;
