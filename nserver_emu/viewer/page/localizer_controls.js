// The controls of the window Localization: start, find, kidnap, stop, the filter and the noise. The server runs the
// localizer in a process of its own for each robot, and reports its state with the message `localizers`.

import { element, button, choice } from './widgets.js';
import { callLocalizer, control, poseTenths } from './commands.js';
import { robotFits } from './geometry.js';
import { worldBounds } from './scene.js';

const METHODS = { finder: 'finder: recovers when lost', ekf: 'ekf: extended Kalman filter', iekf: 'iekf: iterated Kalman filter',
  ukf: 'ukf: unscented Kalman filter', smoother: 'smoother: fixed-lag', mcl: 'mcl: particles', offsets: 'offsets: with sonar offsets' };
const NOISE_PARTS = { sensors: 'Sensors', motion: 'Motion' };
// A kidnapped robot is at least this many of its radii away, so that no filter takes it for noise.
const MIN_KIDNAP_RADII = 4, KIDNAP_ATTEMPTS = 2000;

export function localizerControls(app, stateOf) {
  const method = element('select', { id: 'method' }, ...Object.entries(METHODS).map(([name, title]) => element('option', { value: name }, title)));
  // Filters of the user, which the server was started with; a path is shown by its last part.
  let offered;
  const offerOwn = () => {
    if (!app.ownMethods || offered === app.ownMethods) return;
    offered = app.ownMethods;
    method.querySelectorAll('.own').forEach((option) => option.remove());
    method.append(...offered.map((name) => element('option', { value: name, className: 'own', title: name }, `own: ${name.split('/').at(-1)}`)));
  };
  const start = (isLost, resumes = false) => callLocalizer(app, { do: 'localize', method: method.value, is_lost: isLost, resumes });
  // Start a localizer that runs again, on the present map.
  app.restartLocalizer = () => { if (isActive(stateOf())) start(false); };
  const buttons = {
    localize: button('Localize', () => start(false), { id: 'localize', title: 'Start the filter at the pose of the encoders' }),
    find: button('Find', () => start(true), { id: 'find', title: 'Start without a pose: the robot drives until it has found itself (method finder)' }),
    kidnap: button('Kidnap', () => kidnap(app), { id: 'kidnap', title: 'Place the robot somewhere else without its encoders noticing' }),
    stop: button('Stop localizing', () => callLocalizer(app, { do: 'unlocalize' }), { id: 'unlocalize' }),
  };
  const noise = noiseControls(app, (part) => {
    // The filter assumes the sonars of its start: it is started again, from where it is.
    if (part === 'sensors' && isActive(stateOf())) start(false, true);
  });
  const box = element('div', { className: 'acts live', role: 'group', ariaLabel: 'Localizer' },
    element('div', { className: 'row' }, buttons.localize, buttons.find, buttons.kidnap, buttons.stop),
    element('div', { className: 'row' }, element('label', {}, 'Method', method)), noise.box);
  return { box, update() {
    offerOwn();
    buttons.stop.disabled = !isActive(stateOf());
    noise.update();
  } };
}

// Return true if a localizer that a page has started runs.
export function isActive(run) { return ['starting', 'running'].includes(run?.state); }

function noiseControls(app, onChange) {
  const all = element('input', { type: 'checkbox', id: 'noise-all' });
  const target = () => (all.checked ? {} : { robot: Number(app.robot) });
  const change = async (part, value) => { if ((await control(app, 'noise', { [part]: value, ...target() })).ok) onChange(part); };
  const choices = Object.fromEntries(Object.entries(NOISE_PARTS).map(([part, title]) =>
    [part, choice(title, { id: `noise-${part}` }, (value) => change(part, value))]));
  const box = element('div', { className: 'row', id: 'localizer-noise', role: 'group', ariaLabel: 'Noise' }, ...Object.values(choices).map(({ label }) => label),
    element('label', {}, all, 'all robots'));
  return { box, update() {
    const body = app.scene.bodies[app.robot];
    for (const part of body ? Object.keys(NOISE_PARTS) : []) choices[part].offer(body.noises[part], body.noise[part]);
  } };
}

function kidnap(app) {
  const pose = randomPose(app.scene, app.robot, Math.random);
  if (pose) callLocalizer(app, { do: 'kidnap', pose: poseTenths(pose) });
  else app.notice('There is no other place for this robot in this world.');
}

// Return a random pose where the robot fits, away from where it is, or null. `random` returns numbers from 0 to 1.
export function randomPose(scene, id, random) {
  const [x1, y1, x2, y2] = worldBounds(scene), [x, y] = scene.robots[id].actual, far = MIN_KIDNAP_RADII * scene.bodies[id].radius_in;
  for (let k = 0; k < KIDNAP_ATTEMPTS; k += 1) {
    const place = [x1 + (x2 - x1) * random(), y1 + (y2 - y1) * random()];
    if (Math.hypot(place[0] - x, place[1] - y) < far || !robotFits(scene, id, place)) continue;
    const angle = 2 * Math.PI * random();
    return [...place, angle, angle];
  }
  return null;
}
