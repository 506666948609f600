// The windows Robot, Short sensors and Long sensors: State as text and numbers, the sensor rings from above, and the
// sonars over time.

import { HISTORY_S, infraredAngle, isEcho, shownRange, sonarReadings } from './scene.js';
import { lengthText, degreesText, unitIn, unitName } from './units.js';
import { cell, element, table, sizedPen } from './widgets.js';
import { loadPreference, savePreference } from './browser_storage.js';
import { timeAxis } from './charts.js';

const MODES = { n150: 'steering', n200: 'steering', scout: 'wheels' };

export const robotWindow = {
  id: 'robot', title: 'Robot', closed: true,
  build(box) {
    this.rows = table(box, 'State of the robot');
    this.numbers = element('code');
    this.raw = element('details', { id: 'raw-state', open: loadPreference('raw state', false), ontoggle: () => savePreference('raw state', this.raw.open) },
      element('summary', {}, 'State[0] to State[44]'), this.numbers);
    box.append(this.raw);
  },
  update(app) {
    const { robot, body, scene } = app.selected();
    if (!robot) return;
    for (const [name, text] of stateRows(robot, body, scene, app.metric, app.robot)) cell(this.rows, name, text);
    const numbers = robot.state.join(' ');
    if (this.raw.open && this.numbers.textContent !== numbers) this.numbers.textContent = numbers;
  },
};

// Describe the laser modes: each client has its own, and the map shows points if any of them has the laser on.
function laserText(body, clients = []) {
  if (!body.sees) return null;
  if (!clients.length) return 'on, as at power-on: no client is connected';
  const names = (on) => clients.filter(([, mode]) => Boolean(mode & 1) === on).map(([name, mode]) => `${name} (mode ${mode})`).join(', ');
  return [['on for', names(true)], ['off for', names(false)]].filter(([, list]) => list).map((parts) => parts.join(' ')).join('; ');
}

// Return State[0..44] and the true state as rows [name, text].
function stateRows(robot, body, scene, metric, id) {
  const s = robot.state, tenth = (slot) => lengthText(s[slot] / 10, metric);
  const angle = (slot) => degreesText(s[slot] * Math.PI / 1800);
  const speed = (slot) => `${lengthText(s[slot] / 10, metric)}/s`, turn = (slot) => `${(s[slot] / 10).toFixed(1)}°/s`;
  const axes = MODES[body.family] === 'wheels' ? ['right wheel', 'left wheel'] : ['translation', 'steering', 'turret'];
  const moving = axes.filter((_, k) => s[41] >> k & 1);
  const touched = [...Array(body.bumpers).keys()].filter((k) => s[33] >> k & 1);
  const error = Math.hypot(robot.actual[0] - robot.encoder[0], robot.actual[1] - robot.encoder[1]);
  return [
    ['model', body.model],
    ['encoder position', `${tenth(34)}, ${tenth(35)}`],
    ['steering, turret', `${angle(36)}, ${angle(37)}`],
    ['true position', `${lengthText(robot.actual[0], metric)}, ${lengthText(robot.actual[1], metric)}`],
    ['true angles', `${degreesText(robot.actual[2])}, ${degreesText(robot.actual[3])}`],
    ['encoder error', lengthText(error, metric)],
    ...(body.differential ? [['wheels', `${speed(38)} right, ${speed(39)} left`]]
      : [['velocities', `${speed(38)}, ${turn(39)}, ${turn(40)}`]]),
    ['moving', moving.length ? moving.join(', ') : 'nothing'],
    ['bumpers', touched.length ? `touched: ${touched.join(', ')}` : 'free'],
    ['compass', angle(43)],
    ['laser', laserText(body, scene.laser_modes[id])],
    ['State[0] (speed)', s[0] === 9999 ? 'as fast as possible' : s[0] === 0 ? 'paused' : `${s[0] / 10} x real time`],
    ['last speech', scene.speech.findLast(([, robotId]) => String(robotId) === String(id))?.[2] ?? 'none'],
  ];
}

export const shortWindow = {
  id: 'short', title: 'Short sensors', closed: true,
  build(box) { this.canvas = polarCanvas(box, 'Infrared ring and bumpers from above'); this.rows = table(box, 'Infrared'); },
  update(app) {
    const { robot, body } = app.selected();
    if (!robot) return;
    const readings = robot.state.slice(1, 17);
    polar(this.canvas, app.theme, { values: readings, max: 15, colour: app.theme.infrared, off: !body.sees,
      turn: robot.actual[3], steer: robot.actual[2], bumpers: body.bumpers, touched: robot.state[33],
      frame: robot.front, metric: app.metric });
    this.canvas.ariaLabel = body.sees ? 'Infrared ring and bumpers from above' : 'Bumpers from above';
    cell(this.rows, 'infrared', body.sees ? readings.join(' ') : null);
    cell(this.rows, 'bumper bits', `0x${(robot.state[33] >>> 0).toString(16)}`);
  },
};

export const longWindow = {
  id: 'long', title: 'Long sensors', closed: true,
  build(box) {
    this.canvas = polarCanvas(box, 'Sonar ring from above');
    this.strips = document.createElement('canvas');
    this.strips.setAttribute('role', 'img');
    this.strips.setAttribute('aria-label', `The sonars over the last ${HISTORY_S} seconds`);
    box.append(this.strips);
    this.rows = table(box, 'Sonars');
  },
  update(app) {
    const { robot, body, scene, id } = app.selected();
    if (!robot || !body) return;
    const readings = sonarReadings(robot, body), ring = body.sonars;
    polar(this.canvas, app.theme, { values: readings.map((reading) => shownRange(reading, ring)), max: polarRange(readings, ring), colour: app.theme.sonar,
      turn: robot.actual[3], steer: robot.actual[2], numbered: true, metric: app.metric, angles: ring.angles });
    drawStrips(this.strips, app.theme, scene.history[id] ?? [], scene.time_s, app.metric, ring);
    const shown = (reading) => Math.round(reading / unitIn(app.metric));
    cell(this.rows, 'sonars', readings.map(shown).join(' '));
    cell(this.rows, 'unit', `${app.metric ? 'centimetres' : 'inches'}, ${shown(ring.no_echo_in)} without an echo`);
  },
};

function polarCanvas(box, label) {
  const canvas = document.createElement('canvas');
  canvas.setAttribute('role', 'img');
  canvas.setAttribute('aria-label', label);
  box.append(canvas);
  return canvas;
}

// Return the range shown in a ring plot: 30, 60, 120 inches or the maximum, so that small rooms fill it.
export function polarRange(readings, ring) {
  const maximum = Math.max(0, ...readings.filter((reading) => isEcho(reading, ring)));
  return [30, 60, 120].find((range) => maximum <= range && range < ring.max_in) ?? ring.max_in;
}

// Plot a ring of sensors from above, turned as the robot in the world, with circles at thirds of the range.
function polar(canvas, theme, { values, max, colour, off, turn, steer, bumpers = 0, touched = 0, frame = 0, numbered, metric, angles }) {
  const pen = sizedPen(canvas, off ? 0.25 : 0.62);
  if (!pen) return;
  const cx = pen.width / 2, cy = pen.height / 2, inner = 16, outer = Math.min(cx, cy) - 18;
  const at = (angle, r) => [cx + r * Math.cos(angle), cy - r * Math.sin(angle)];
  const looks = (k) => (angles ? angles[k] : infraredAngle(k));
  pen.strokeStyle = theme.edge;
  pen.fillStyle = theme.quiet;
  pen.font = '11px system-ui, sans-serif';
  for (const fraction of off ? [] : [1 / 3, 2 / 3, 1]) {
    pen.beginPath();
    pen.arc(cx, cy, inner + fraction * (outer - inner), 0, 2 * Math.PI);
    pen.stroke();
    const far = Math.round(fraction * max / unitIn(metric));
    pen.fillText(fraction === 1 ? `${far} ${unitName(metric)}` : String(far), cx + 3, cy - inner - fraction * (outer - inner) + 11);
  }
  if (numbered) {
    pen.textAlign = 'center';
    values.forEach((_, k) => { const [x, y] = at(turn + looks(k), outer + 10); pen.fillText(String(k), x, y + 4); });
    pen.textAlign = 'left';
  }
  // 1. The readings, as a polygon with its corners marked.
  if (!off) {
    const reach = values.map((value) => inner + Math.min(value, max) / max * (outer - inner));
    pen.fillStyle = pen.strokeStyle = colour;
    pen.beginPath();
    // Around the robot, whatever the order of the numbers.
    const around = reach.map((_, k) => k).sort((a, b) => wrapped(looks(a)) - wrapped(looks(b)));
    around.forEach((k, n) => (n ? pen.lineTo : pen.moveTo).call(pen, ...at(turn + looks(k), reach[k])));
    pen.closePath();
    pen.globalAlpha = 0.2; pen.fill(); pen.globalAlpha = 1;
    pen.stroke();
    reach.forEach((r, k) => { const [x, y] = at(turn + looks(k), r); pen.fillRect(x - 2, y - 2, 4, 4); });
  }
  // 2. The robot with its steering direction.
  pen.strokeStyle = theme.actual;
  pen.lineWidth = 2;
  pen.beginPath();
  pen.arc(cx, cy, inner - 3, 0, 2 * Math.PI);
  pen.moveTo(cx, cy);
  pen.lineTo(...at(steer, inner - 3));
  pen.stroke();
  // 3. The touched bumpers.
  pen.strokeStyle = theme.hit;
  pen.lineWidth = 4;
  for (let k = 0; k < bumpers; k += 1) {
    if (!(touched >> k & 1)) continue;
    const middle = frame + k * 2 * Math.PI / bumpers, half = Math.PI / bumpers;
    pen.beginPath();
    pen.arc(cx, cy, inner, -middle - half, -middle + half);
    pen.stroke();
  }
}

function wrapped(angle) { const turn = 2 * Math.PI; return ((angle % turn) + turn) % turn; }

// Plot strips, one per sonar, the latest reading at the right, scaled to the largest recent reading.
function drawStrips(canvas, theme, samples, now_s, metric, ring) {
  const pen = sizedPen(canvas, 1);
  if (!pen) return;
  const reach = polarRange(samples.flatMap((sample) => sample.sonars), ring), count = ring.angles.length;
  const left = 22, high = (pen.height - 30) / count, wide = pen.width - left - 4;
  pen.font = '11px system-ui, sans-serif';
  pen.fillStyle = theme.quiet;
  pen.fillText(`a strip is ${Math.round(reach / unitIn(metric))} ${unitName(metric)} high`, left, 10);
  timeAxis(pen, theme, { left, right: pen.width - 4, y: pen.height - 3, span_s: HISTORY_S });
  pen.translate(0, 14);
  for (let k = 0; k < count; k += 1) {
    const bottom = (k + 1) * high - 2;
    pen.fillStyle = theme.quiet;
    pen.fillText(String(k), 2, bottom - high / 2 + 4);
    pen.strokeStyle = theme.edge;
    pen.beginPath(); pen.moveTo(left, bottom); pen.lineTo(pen.width - 4, bottom); pen.stroke();
    pen.strokeStyle = theme.sonar;
    pen.beginPath();
    samples.forEach((sample, n) => {
      const x = left + wide * (1 - (now_s - sample.time_s) / HISTORY_S);
      const y = bottom - Math.min(shownRange(sample.sonars[k], ring) / reach, 1) * (high - 4);
      (n ? pen.lineTo : pen.moveTo).call(pen, x, y);
    });
    pen.stroke();
  }
}
