// The windows Knob and keys, for driving while they are pressed, and Pose in numbers, for placing the robot. Hidden on
// read-only pages.

import { element, button, field, form, lengthField } from './widgets.js';
import { callRobot, placeRobot } from './commands.js';

const REPEAT_MS = 150,  // the server stops a robot without a new command for 0.5 s
  SPEED_IN_S = 10, TURN_DEG_S = 30;
const KEYS = { w: [1, 0, 0], s: [-1, 0, 0], a: [0, 1, 0], d: [0, -1, 0], q: [0, 0, 1], e: [0, 0, -1] };

// Return the arguments of vm in tenths, from fractions (-1 to 1) of the top speeds: forward, left, turret left. For a Scout
// they are the speeds of its wheels, which travel 0.118597 in per degree of turn.
function velocities(body, [forward, left, turret], speed_in_s, turn_deg_s) {
  if (!body.differential) return [10 * forward * speed_in_s, 10 * left * turn_deg_s, 10 * turret * turn_deg_s].map(Math.round);
  const turning = left * turn_deg_s * 0.118597;
  return [10 * (forward * speed_in_s + turning), 10 * (forward * speed_in_s - turning), 0].map(Math.round);
}

// Drive while knob or keys are pressed: the command is repeated, and the robot stopped on release, when the page is hidden,
// or when another robot is selected.
export const driveWindow = {
  id: 'drive', title: 'Knob and keys',
  build(box, app) {
    const pressed = new Set();
    let stick = null, timer = null;
    this.speed = lengthField(app, 'speed', SPEED_IN_S, { min: 0, max: 99, step: 1 }, '/s');
    this.turn = field('turn, °/s', { type: 'number', min: 0, max: 45, step: 1, value: TURN_DEG_S });
    const knob = element('i'), pad = element('div', { className: 'pad', tabIndex: 0, id: 'pad' }, knob);
    pad.setAttribute('role', 'application');
    pad.setAttribute('aria-label', 'Drive: drag the knob, or hold W, A, S, D; Q and E turn the turret. Release to stop.');
    const fractions = () => {
      const sum = stick ? [...stick] : [0, 0, 0];
      for (const key of pressed) KEYS[key].forEach((value, k) => { sum[k] += value; });
      return sum.map((value) => Math.max(-1, Math.min(1, value)));
    };
    const go = async () => {
      const body = app.scene.bodies[app.robot], robot = app.robot;
      if (!body) return;
      if (!timer) timer = setInterval(go, REPEAT_MS);
      const args = velocities(body, fractions(), this.speed.inches, Number(this.turn.input.value));
      const answer = await app.link.request({ do: 'drive', robot: Number(robot), args });
      if (!answer.ok) app.notice(answer.error);
      else if (answer.others?.length) app.notice(`${answer.others.join(' and ')} also drives robot ${robot}: the last command counts.`);
    };
    this.release = () => {
      pressed.clear();
      stick = null;
      knob.style.transform = '';
      if (timer === null) return;
      clearInterval(timer);
      timer = null;
      callRobot(app, 'st', []);
    };
    pad.addEventListener('keydown', (event) => {
      const key = event.key.toLowerCase();
      if (!KEYS[key] || event.ctrlKey || event.metaKey || event.altKey) return;
      event.preventDefault();
      if (!pressed.has(key) && !event.repeat) { pressed.add(key); go(); }  // after a stop a new key press is needed
    });
    pad.addEventListener('keyup', (event) => {
      if (!pressed.delete(event.key.toLowerCase())) return;
      if (!pressed.size && !stick) this.release(); else go();
    });
    const onMove = (event) => {
      const box = pad.getBoundingClientRect(), radius = box.width / 2;
      const x = (event.clientX - box.left - radius) / radius, y = (event.clientY - box.top - radius) / radius;
      const length = Math.max(1, Math.hypot(x, y));
      stick = [-y / length, -x / length, 0];
      knob.style.transform = `translate(${x / length * (radius - 18)}px, ${y / length * (radius - 18)}px)`;
    };
    pad.addEventListener('pointerdown', (event) => { pad.setPointerCapture(event.pointerId); pad.focus(); onMove(event); go(); });
    pad.addEventListener('pointermove', (event) => { if (stick) onMove(event); });
    for (const end of ['pointerup', 'pointercancel', 'blur']) pad.addEventListener(end, this.release);
    document.addEventListener('visibilitychange', () => { if (document.hidden) this.release(); });
    box.append(element('div', { className: 'row' }, pad, element('div', { style: 'flex: 1 1 9rem' },
      element('p', { className: 'quiet' }, 'Drag the knob, or focus it and hold W A S D, Q E for the turret. Release to stop.'),
      element('div', { className: 'row' }, this.speed.label, this.turn.label))));
  },
  update() {},
};

export const poseWindow = {
  id: 'pose', title: 'Pose in numbers', closed: true,
  build(box, app) {
    this.pose = [lengthField(app, 'x', 0), lengthField(app, 'y', 0),
      ...['steering, °', 'turret, °'].map((name) => field(name, { type: 'number', step: 'any', value: 0 }))];
    box.append(form(() => placeRobot(app, app.robot, this.enteredPose()), element('div', { className: 'row', role: 'group', ariaLabel: 'Pose' },
      ...this.pose.map((one) => one.label),
      button('Copy from robot', () => this.copyPose(app)),
      element('button', { id: 'place-robot' }, 'Place robot'),
      button('Give this pose', () => app.givePose(this.enteredPose()), { id: 'give-pose', title: 'To a program that requests one (get_robot_conf)' }))));
  },
  enteredPose() {
    const [steer, turret] = this.pose.slice(2).map((one) => Number(one.input.value) * Math.PI / 180);
    return [this.pose[0].inches, this.pose[1].inches, steer, turret];
  },
  copyPose(app) {
    const [x, y, steer, turret] = app.scene.robots[app.robot].actual;
    this.pose[0].inches = x;
    this.pose[1].inches = y;
    [steer, turret].forEach((angle, k) => { this.pose[2 + k].input.value = (angle * 180 / Math.PI).toFixed(1); });
  },
  update() {},
};
