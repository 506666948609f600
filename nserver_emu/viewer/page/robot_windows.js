// The windows Robot, Short sensors and Long sensors: State in words and numbers, the rings seen from above, the
// sixteen sonars over time. Rules: read the scene, change nothing of it.

import { HISTORY_S } from './scene.js';
import { lengthText, degreesText, unitIn, unitName } from './units.js';
import { cell, table, sizedPen } from './parts.js';
import { timeAxis } from './charts.js';

const MODES = { n150: 'steering', n200: 'steering', scout: 'wheels' };

export const robotWindow = {
  id: 'robot', title: 'Robot',
  build(box) { this.rows = table(box, 'State of the robot'); },
  update(app) {
    const { robot, body, scene } = app.chosen();
    if (!robot) return;
    for (const [name, text] of stateInWords(robot, body, scene, app.metric, app.robot)) cell(this.rows, name, text);
  },
};

// Whose laser mode the map follows: each client has its own, and what any of them is told is drawn.
export function laserInWords(body, clients = []) {
  if (!body.sees) return 'this robot has none';
  if (!clients.length) return 'on, as at power-on: it has no client';
  const told = (on) => clients.filter(([, mode]) => Boolean(mode & 1) === on).map(([name, mode]) => `${name} (mode ${mode})`).join(', ');
  return [['on for', told(true)], ['off for', told(false)]].filter(([, names]) => names).map((parts) => parts.join(' ')).join('; ');
}

// State[0..44] as a person says it; [what, text] each.
export function stateInWords(robot, body, scene, metric, who) {
  const s = robot.state, tenth = (slot) => lengthText(s[slot] / 10, metric);
  const angle = (slot) => degreesText(s[slot] * Math.PI / 1800);
  const speed = (slot) => `${lengthText(s[slot] / 10, metric)}/s`, turn = (slot) => `${(s[slot] / 10).toFixed(1)}°/s`;
  const axes = MODES[body.family] === 'wheels' ? ['right wheel', 'left wheel'] : ['translation', 'steering', 'turret'];
  const moving = axes.filter((_, k) => s[41] >> k & 1);
  const touched = [...Array(body.bumpers).keys()].filter((k) => s[33] >> k & 1);
  const off = Math.hypot(robot.actual[0] - robot.encoder[0], robot.actual[1] - robot.encoder[1]);
  return [
    ['model', body.model],
    ['encoders say', `${tenth(34)}, ${tenth(35)}`],
    ['steering, turret', `${angle(36)}, ${angle(37)}`],
    ['really at', `${lengthText(robot.actual[0], metric)}, ${lengthText(robot.actual[1], metric)}`],
    ['really heading', `${degreesText(robot.actual[2])}, ${degreesText(robot.actual[3])}`],
    ['encoders off by', lengthText(off, metric)],
    ...(body.differential ? [['wheels', `${speed(38)} right, ${speed(39)} left`]]
      : [['velocities', `${speed(38)}, ${turn(39)}, ${turn(40)}`]]),
    ['moving', moving.length ? moving.join(', ') : 'nothing'],
    ['bumpers', touched.length ? `touched: ${touched.join(', ')}` : 'free'],
    ['compass', angle(43)],
    ['laser', laserInWords(body, scene.laser_modes[who])],
    ['State[0] (speed)', s[0] === 9999 ? 'as fast as it can' : s[0] === 0 ? 'time stands' : `${s[0] / 10} x real time`],
    ['said last', scene.said.findLast(([, id]) => String(id) === String(who))?.[2] ?? 'nothing'],
    ['numbers', s.join(' ')],
  ];
}

export const shortWindow = {
  id: 'short', title: 'Short sensors',
  build(box) { this.canvas = polarCanvas(box, 'Infrared ring and bumpers from above'); this.rows = table(box, 'Infrared'); },
  update(app) {
    const { robot, body } = app.chosen();
    if (!robot) return;
    const readings = robot.state.slice(1, 17);
    polar(this.canvas, app.theme, { values: readings, most: 15, colour: app.theme.infrared, off: !body.sees,
      turn: robot.actual[3], steer: robot.actual[2], bumpers: body.bumpers, touched: robot.state[33],
      frame: robot.front, metric: app.metric });
    cell(this.rows, 'infrared', body.sees ? readings.join(' ') : 'this robot has none');
    cell(this.rows, 'bumper bits', `0x${(robot.state[33] >>> 0).toString(16)}`);
  },
};

export const longWindow = {
  id: 'long', title: 'Long sensors',
  build(box) {
    this.canvas = polarCanvas(box, 'Sonar ring from above');
    this.strips = document.createElement('canvas');
    this.strips.setAttribute('role', 'img');
    this.strips.setAttribute('aria-label', `The sixteen sonars over the last ${HISTORY_S} seconds`);
    box.append(this.strips);
    this.rows = table(box, 'Sonars');
  },
  update(app) {
    const { robot, scene, id } = app.chosen();
    if (!robot) return;
    const readings = robot.state.slice(17, 33);
    polar(this.canvas, app.theme, { values: readings, most: polarReach(readings), nothing: 255, colour: app.theme.sonar,
      turn: robot.actual[3], steer: robot.actual[2], numbered: true, metric: app.metric });
    drawStrips(this.strips, app.theme, scene.history[id] ?? [], scene.time_s, app.metric);
    cell(this.rows, 'sonars 0 to 15', readings.map((reading) => Math.round(reading / unitIn(app.metric))).join(' '));
    cell(this.rows, 'in', app.metric ? 'centimetres, 648 for nothing heard' : 'inches, 255 for nothing heard');
  },
};

function polarCanvas(box, label) {
  const canvas = document.createElement('canvas');
  canvas.setAttribute('role', 'img');
  canvas.setAttribute('aria-label', label);
  box.append(canvas);
  return canvas;
}

// How far the view of a ring goes, so that a small room fills it: 30, 60, 120 or all 255 inches.
export function polarReach(readings) {
  const farthest = Math.max(0, ...readings.filter((reading) => reading < 255));
  return [30, 60, 120].find((reach) => farthest <= reach) ?? 255;
}

// A ring of sixteen from above, as the robot is turned in the world; rings of the plot at a third each.
function polar(canvas, theme, { values, most, colour, off, turn, steer, bumpers = 0, touched = 0, frame = 0, numbered, metric }) {
  const pen = sizedPen(canvas, 0.62);
  if (!pen) return;
  const cx = pen.width / 2, cy = pen.height / 2, inner = 16, outer = Math.min(cx, cy) - 18;
  const at = (angle, r) => [cx + r * Math.cos(angle), cy - r * Math.sin(angle)];
  pen.strokeStyle = theme.edge;
  pen.fillStyle = theme.quiet;
  pen.font = '11px system-ui, sans-serif';
  for (const share of [1 / 3, 2 / 3, 1]) {
    pen.beginPath();
    pen.arc(cx, cy, inner + share * (outer - inner), 0, 2 * Math.PI);
    pen.stroke();
    const far = Math.round(share * most / unitIn(metric));
    pen.fillText(share === 1 ? `${far} ${unitName(metric)}` : String(far), cx + 3, cy - inner - share * (outer - inner) + 11);
  }
  if (numbered) {
    pen.textAlign = 'center';
    for (let k = 0; k < 16; k += 1) { const [x, y] = at(turn + k * Math.PI / 8, outer + 10); pen.fillText(String(k), x, y + 4); }
    pen.textAlign = 'left';
  }
  if (!off) {
    const reach = values.map((value) => inner + Math.min(value, most) / most * (outer - inner));
    pen.fillStyle = pen.strokeStyle = colour;
    pen.beginPath();
    reach.forEach((r, k) => (k ? pen.lineTo : pen.moveTo).call(pen, ...at(turn + k * Math.PI / 8, r)));
    pen.closePath();
    pen.globalAlpha = 0.2; pen.fill(); pen.globalAlpha = 1;
    pen.stroke();
    reach.forEach((r, k) => { const [x, y] = at(turn + k * Math.PI / 8, r); pen.fillRect(x - 2, y - 2, 4, 4); });
  }
  pen.strokeStyle = theme.actual;
  pen.lineWidth = 2;
  pen.beginPath();
  pen.arc(cx, cy, inner - 3, 0, 2 * Math.PI);
  pen.moveTo(cx, cy);
  pen.lineTo(...at(steer, inner - 3));
  pen.stroke();
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

// Sixteen strips, one a sonar, the latest at the right; as high as what was heard of late is far.
function drawStrips(canvas, theme, samples, now_s, metric) {
  const pen = sizedPen(canvas, 1);
  if (!pen) return;
  const reach = polarReach(samples.flatMap((sample) => sample.sonars)), left = 22, high = (pen.height - 30) / 16, wide = pen.width - left - 4;
  pen.font = '11px system-ui, sans-serif';
  pen.fillStyle = theme.quiet;
  pen.fillText(`a strip is ${Math.round(reach / unitIn(metric))} ${unitName(metric)} high`, left, 10);
  timeAxis(pen, theme, { left, right: pen.width - 4, y: pen.height - 3, span_s: HISTORY_S });
  pen.translate(0, 14);
  for (let k = 0; k < 16; k += 1) {
    const bottom = (k + 1) * high - 2;
    pen.fillStyle = theme.quiet;
    pen.fillText(String(k), 2, bottom - high / 2 + 4);
    pen.strokeStyle = theme.edge;
    pen.beginPath(); pen.moveTo(left, bottom); pen.lineTo(pen.width - 4, bottom); pen.stroke();
    pen.strokeStyle = theme.sonar;
    pen.beginPath();
    samples.forEach((sample, n) => {
      const x = left + wide * (1 - (now_s - sample.time_s) / HISTORY_S);
      const y = bottom - Math.min(sample.sonars[k] / reach, 1) * (high - 4);
      (n ? pen.lineTo : pen.moveTo).call(pen, x, y);
    });
    pen.stroke();
  }
}
