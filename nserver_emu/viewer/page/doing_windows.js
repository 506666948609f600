// The windows Drive, Time and World: what can be done without the map, and by keyboard. Shown to who may act.

import { element, button, field, download } from './parts.js';
import { placeRobot, addObstacle, deleteObstacle, moveObstacle, tell } from './tools.js';
import { CM_PER_IN } from './units.js';

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
    this.speed = field('speed, in/s', { type: 'number', min: 0, max: 39, step: 1, value: SPEED_IN_S });
    this.turn = field('turn, °/s', { type: 'number', min: 0, max: 45, step: 1, value: TURN_DEG_S });
    const knob = element('i'), pad = element('div', { className: 'pad', tabIndex: 0, id: 'pad' }, knob);
    pad.setAttribute('role', 'application');
    pad.setAttribute('aria-label', 'Drive: drag the knob, or hold W, A, S, D; Q and E turn the turret. Let go to stop.');
    const shares = () => {
      const sum = stick ? [...stick] : [0, 0, 0];
      for (const key of held) KEYS[key].forEach((share, k) => { sum[k] += share; });
      return sum.map((share) => Math.max(-1, Math.min(1, share)));
    };
    const go = () => {
      const body = app.scene.bodies[app.robot], now = shares();
      if (!body) return;
      const args = driveWords(body, now, Number(this.speed.input.value), Number(this.turn.input.value));
      app.link.ask({ do: 'drive', robot: Number(app.robot), args }).then((answer) => { if (!answer.ok) app.notice(answer.error); });
      if (!timer) timer = setInterval(go, AGAIN_MS);
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
      if (!held.has(key)) { held.add(key); go(); }
    });
    pad.addEventListener('keyup', (event) => {
      held.delete(event.key.toLowerCase());
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
    box.append(element('div', { className: 'row' }, pad, element('div', {},
      element('p', { className: 'quiet' }, 'Drag the knob, or focus it and hold W A S D, Q E for the turret. Let go to stop.'),
      element('div', { className: 'row' }, this.speed.label, this.turn.label))));
    this.pose = ['x, in', 'y, in', 'steering, °', 'turret, °'].map((name) => field(name, { type: 'number', step: 'any', value: 0 }));
    box.append(element('div', { className: 'row' }, ...this.pose.map((part) => part.label),
      button('Take from robot', () => this.takePose(app)),
      button('Place robot', () => placeRobot(app, app.robot, this.typedPose()), { id: 'place-robot' }),
      button('Give this pose', () => app.givePose(this.typedPose()), { id: 'give-pose' })));
  },
  typedPose() {
    const [x, y, steer, turret] = this.pose.map((part) => Number(part.input.value));
    return [x, y, steer * Math.PI / 180, turret * Math.PI / 180];
  },
  takePose(app) {
    const [x, y, steer, turret] = app.scene.robots[app.robot].actual;
    [x, y, steer * 180 / Math.PI, turret * 180 / Math.PI].forEach((n, k) => { this.pose[k].input.value = n.toFixed(1); });
  },
  update() {},
};

export const timeWindow = {
  id: 'time', title: 'Time and faults', acts: true,
  build(box, app) {
    const ask = async (command, argument) => {
      const answer = await app.link.ask({ do: 'control', command, argument });
      app.notice(answer.ok ? '' : answer.error);
      return answer;
    };
    this.pause = button('Pause', () => ask(app.scene.paused ? 'resume' : 'pause'), { id: 'pause' });
    this.step = field('s', { type: 'number', min: 0.001, max: 60, step: 'any', value: 0.1 });
    this.factor = field('times real time', { type: 'number', min: 0.1, max: 999, step: 'any', value: 1, id: 'factor',
      onchange: () => ask('speed', this.factor.input.value) });
    const plan = element('textarea', { rows: 5, style: 'width:100%', spellcheck: false, id: 'faults' });
    plan.setAttribute('aria-label', 'Plan of faults in TOML');
    const show = async () => { const answer = await ask('faults show'); if (answer.ok) plan.value = answer.said.plan; };
    box.append(
      element('div', { className: 'row' }, this.pause, button('Step', () => ask('step', Number(this.step.input.value)), { id: 'step' }),
        this.step.label, this.factor.label, button('As fast as it can', () => ask('speed', 'max'))),
      element('details', {}, element('summary', {}, 'Faults on purpose'), plan, element('div', { className: 'row' },
        button('Show what is in force', show),
        button('Put in force', async () => { if ((await ask('faults set', { text: plan.value, file: 'the page' })).ok) show(); }, { id: 'faults-set' }),
        button('Clear', async () => { if ((await ask('faults clear')).ok) show(); }))));
  },
  update(app) { this.pause.textContent = app.scene.paused ? 'Resume' : 'Pause'; },
};

// An obstacle as it stands in a world file, and all of a world.
export function worldText(world) {
  const point = ([x, y]) => `[${x}, ${y}]`;
  const lines = [`name = ${JSON.stringify(world.name)}`, `title = ${JSON.stringify(world.title)}`];
  const outline = (kind, thing) => lines.push('', `[[${kind}]]`, ...(thing.name ? [`name = ${JSON.stringify(thing.name)}`] : []),
    `corners_in = [${thing.corners.map(point).join(', ')}]`);
  for (const room of world.rooms) outline('room', room);
  const edges = world.rooms.reduce((sum, room) => sum + room.corners.length, 0);
  for (const [x1, y1, x2, y2] of world.walls.slice(edges)) lines.push('', '[[wall]]', `points_in = [${point([x1, y1])}, ${point([x2, y2])}]`);
  for (const thing of world.obstacles) outline('obstacle', thing);
  for (const [x, y, steer, turret] of world.starts) {
    lines.push('', '[[start]]', `x_in = ${x}`, `y_in = ${y}`, `steering_deg = ${steer}`, `turret_deg = ${turret}`);
  }
  return `${lines.join('\n')}\n`;
}

// The obstacles of a world file: corners as the page reads them, whatever their unit.
export function obstaclesOf(text) {
  const units = { in: 1, cm: 1 / CM_PER_IN, m: 100 / CM_PER_IN }, found = [];
  for (const part of text.split(/^\s*\[\[/m).filter((block) => block.startsWith('obstacle'))) {
    const said = part.match(/corners_(in|cm|m)\s*=\s*(\[[\s\S]*\])/);
    if (!said) continue;
    const corners = JSON.parse(said[2].replace(/#.*$/gm, '').replace(/,(\s*\])/g, '$1'));
    found.push(corners.map(([x, y]) => [x * units[said[1]], y * units[said[1]]]));
  }
  return found;
}

export const worldWindow = {
  id: 'world', title: 'World', acts: true,
  build(box, app) {
    this.list = element('div');
    this.corners = field('corners, in', { id: 'corners', placeholder: '10,10 20,10 20,20', size: 24 });
    const undo = button('Undo', async () => { await app.undo.pop()?.back(); }, { id: 'undo' });
    const file = element('input', { type: 'file', accept: '.toml', id: 'load-world', hidden: true, onchange: async () => {
      for (const corners of obstaclesOf(await file.files[0].text())) await addObstacle(app, corners);
    } });
    box.append(
      element('div', { className: 'row' }, this.corners.label, button('Add', () => {
        const corners = this.corners.input.value.trim().split(/\s+/).map((pair) => pair.split(',').map(Number));
        if (corners.some((pair) => pair.length !== 2 || !pair.every(Number.isFinite))) app.notice('corners are such as 10,10 20,10 20,20');
        else addObstacle(app, corners);
      }, { id: 'add-corners' })),
      element('div', { className: 'row' }, undo, button('Save world', () => download(`${app.scene.world.name}.toml`, 'text/plain', worldText(app.scene.world)), { id: 'save-world' }),
        file, button('Load obstacles', () => file.click()), button('Remove all obstacles', () => clearWorld(app))),
      this.list);
  },
  update(app) {
    if (this.shown === app.scene.world) return;
    this.shown = app.scene.world;
    const inches = 1;
    this.list.replaceChildren(...(this.shown?.obstacles ?? []).map((thing, k) => element('div', { className: 'row' },
      element('span', {}, `${thing.name || `obstacle ${k + 1}`}: ${thing.corners.map((corner) => corner.join(',')).join(' ')}`),
      ...[['←', -inches, 0], ['→', inches, 0], ['↑', 0, inches], ['↓', 0, -inches]].map(([name, dx, dy]) =>
        button(name, () => moveObstacle(app, thing.corners, dx, dy), { title: `move 1 in ${name}`, ariaLabel: `move obstacle ${k + 1} ${name}` })),
      button('Delete', () => deleteObstacle(app, thing.corners)))));
  },
};

async function clearWorld(app) {
  const gone = app.scene.world.obstacles.map((thing) => thing.corners);
  if (!(await tell(app, 'new_world', [])).ok) return;
  app.undo.push({ title: 'remove all', back: async () => {
    for (const corners of gone) await tell(app, 'add_obstacle', [corners.length, ...corners.flat().map((n) => Math.round(10 * n))]);
  } });
}
