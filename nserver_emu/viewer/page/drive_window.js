// The window Drive: by knob or keys for as long as they are held, and a pose in numbers. Shown to who may act.

import { element, button, field, form, lengthField } from './parts.js';
import { placeRobot, tell } from './tools.js';

const AGAIN_MS = 150, SPEED_IN_S = 10, TURN_DEG_S = 30;
const KEYS = { w: [1, 0, 0], s: [-1, 0, 0], a: [0, 1, 0], d: [0, -1, 0], q: [0, 0, 1], e: [0, 0, -1] };

// Velocities of vm in tenths from shares of the top speeds: forward, left, turret left. A Scout's wheels, else axes.
export function driveWords(body, [forward, left, turret], speed_in_s, turn_deg_s) {
  if (!body.differential) return [10 * forward * speed_in_s, 10 * left * turn_deg_s, 10 * turret * turn_deg_s].map(Math.round);
  const turning = left * turn_deg_s * 0.118597;
  return [10 * (forward * speed_in_s + turning), 10 * (forward * speed_in_s - turning), 0].map(Math.round);
}

// Drives while something is held; says so again and again, and stops when it is let go, hidden, or another is chosen.
export const driveWindow = {
  id: 'drive', title: 'Drive', acts: true,
  build(box, app) {
    const held = new Set();
    let stick = null, timer = null;
    this.speed = lengthField(app, 'speed', SPEED_IN_S, { min: 0, max: 99, step: 1 }, '/s');
    this.turn = field('turn, °/s', { type: 'number', min: 0, max: 45, step: 1, value: TURN_DEG_S });
    const knob = element('i'), pad = element('div', { className: 'pad', tabIndex: 0, id: 'pad' }, knob);
    pad.setAttribute('role', 'application');
    pad.setAttribute('aria-label', 'Drive: drag the knob, or hold W, A, S, D; Q and E turn the turret. Let go to stop.');
    const shares = () => {
      const sum = stick ? [...stick] : [0, 0, 0];
      for (const key of held) KEYS[key].forEach((share, k) => { sum[k] += share; });
      return sum.map((share) => Math.max(-1, Math.min(1, share)));
    };
    const go = async () => {
      const body = app.scene.bodies[app.robot], robot = app.robot;
      if (!body) return;
      if (!timer) timer = setInterval(go, AGAIN_MS);
      const args = driveWords(body, shares(), this.speed.inches, Number(this.turn.input.value));
      const answer = await app.link.ask({ do: 'drive', robot: Number(robot), args });
      if (!answer.ok) app.notice(answer.error);
      else if (answer.others?.length) app.notice(`${answer.others.join(' and ')} drives robot ${robot} as well: the last word counts.`);
    };
    this.release = () => {
      held.clear();
      stick = null;
      knob.style.transform = '';
      if (timer === null) return;
      clearInterval(timer);
      timer = null;
      tell(app, 'st', []);
    };
    pad.addEventListener('keydown', (event) => {
      const key = event.key.toLowerCase();
      if (!KEYS[key] || event.ctrlKey || event.metaKey || event.altKey) return;
      event.preventDefault();
      if (!held.has(key) && !event.repeat) { held.add(key); go(); }  // after a stop a fresh press is needed
    });
    pad.addEventListener('keyup', (event) => {
      if (!held.delete(event.key.toLowerCase())) return;
      if (!held.size && !stick) this.release(); else go();
    });
    const moved = (event) => {
      const where = pad.getBoundingClientRect(), reach = where.width / 2;
      const x = (event.clientX - where.left - reach) / reach, y = (event.clientY - where.top - reach) / reach;
      const far = Math.max(1, Math.hypot(x, y));
      stick = [-y / far, -x / far, 0];
      knob.style.transform = `translate(${x / far * (reach - 18)}px, ${y / far * (reach - 18)}px)`;
    };
    pad.addEventListener('pointerdown', (event) => { pad.setPointerCapture(event.pointerId); pad.focus(); moved(event); go(); });
    pad.addEventListener('pointermove', (event) => { if (stick) moved(event); });
    for (const end of ['pointerup', 'pointercancel', 'blur']) pad.addEventListener(end, this.release);
    document.addEventListener('visibilitychange', () => { if (document.hidden) this.release(); });
    box.append(element('div', { className: 'row' }, pad, element('div', { style: 'flex: 1 1 9rem' },
      element('p', { className: 'quiet' }, 'Drag the knob, or focus it and hold W A S D, Q E for the turret. Let go to stop.'),
      element('div', { className: 'row' }, this.speed.label, this.turn.label))));
    this.pose = [lengthField(app, 'x', 0), lengthField(app, 'y', 0),
      ...['steering, °', 'turret, °'].map((name) => field(name, { type: 'number', step: 'any', value: 0 }))];
    box.append(form(() => placeRobot(app, app.robot, this.typedPose()), element('div', { className: 'row', role: 'group', ariaLabel: 'A pose' },
      ...this.pose.map((one) => one.label),
      button('Take from robot', () => this.takePose(app)),
      element('button', { id: 'place-robot' }, 'Place robot'),
      button('Give this pose', () => app.givePose(this.typedPose()), { id: 'give-pose', title: 'To a program that asks for one (get_robot_conf)' }))));
  },
  typedPose() {
    const [steer, turret] = this.pose.slice(2).map((one) => Number(one.input.value) * Math.PI / 180);
    return [this.pose[0].inches, this.pose[1].inches, steer, turret];
  },
  takePose(app) {
    const [x, y, steer, turret] = app.scene.robots[app.robot].actual;
    this.pose[0].inches = x;
    this.pose[1].inches = y;
    [steer, turret].forEach((angle, k) => { this.pose[2 + k].input.value = (angle * 180 / Math.PI).toFixed(1); });
  },
  update() {},
};
