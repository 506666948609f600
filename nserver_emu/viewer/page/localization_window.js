// The window Localization, and the estimate on the map: what `nomad localize --publish` says. Where it is thought to be
// with its 3-sigma ellipse, the beams taken and refused with the reason, innovation, NIS and error over time.

import { toScreen } from './view.js';
import { circle, arrow } from './draw.js';
import { drawWaypoints } from './tools.js';
import { cell, table, sizedPen, element, button } from './parts.js';
import { lengthText, degreesText } from './units.js';

const KEPT_S = 120, BEAMS_KEPT = 16, GATE_99_9 = 10.828;
export const REASONS = { none: 'used', limit: 'a limit', no_wall: 'no wall there', ambiguous_wall: 'which wall?',
  grazing: 'grazing', gate: 'beyond the gate' };

export const localizationWindow = {
  id: 'localization', title: 'Localization', latest: null, moments: [], beams: new Map(), counts: {},
  build(box, app) {
    this.note = element('p', { className: 'quiet' }, 'Nobody publishes an estimate: nomad localize ... --publish with this page\'s address.');
    box.append(this.note);
    this.rows = table(box, 'Estimate');
    this.charts = ['Innovation, in', 'NIS', 'Error and 3 sigma, in'].map((title) => {
      const canvas = element('canvas', { role: 'img' });
      canvas.setAttribute('aria-label', `${title} over time`);
      box.append(element('div', { className: 'quiet' }, title), canvas);
      return canvas;
    });
    box.append(element('div', { className: 'row acts' },
      button('Waypoints by pointer', () => app.choose('waypoint')),
      button('Clear waypoints', () => { app.waypoints = []; app.waypointsChanged(); }, { id: 'clear-waypoints' })));
  },
  hear(message, app) {
    if (message.type !== 'localization') return;
    const last = this.latest;
    if (last && message.clock_s < last.clock_s) { this.moments = []; this.counts = {}; this.beams.clear(); }
    this.latest = message;
    for (const echo of message.echoes) {
      this.counts[echo.refusal] = (this.counts[echo.refusal] ?? 0) + 1;
      this.beams.delete(echo.sonar);
      this.beams.set(echo.sonar, { ...echo, pose: message.pose, turret: message.turret });
    }
    while (this.beams.size > BEAMS_KEPT) this.beams.delete(this.beams.keys().next().value);
    this.moments.push({ time_s: message.clock_s, echoes: message.echoes, error: errorOf(message), sigma: sigmaOf(message) });
    while (this.moments[0].time_s < message.clock_s - KEPT_S) this.moments.shift();
    app.map.keepDrawing();
    app.changed();
  },
  update(app) {
    const now = this.latest;
    this.note.hidden = Boolean(now);
    if (!now) return;
    const [x, y, heading] = now.pose, error = errorOf(now);
    cell(this.rows, 'estimate', `${lengthText(x, app.metric, 2)}, ${lengthText(y, app.metric, 2)}, ${degreesText(heading)}`);
    cell(this.rows, '3 sigma', `${lengthText(sigmaOf(now), app.metric, 2)}, ${(3 * Math.sqrt(now.cov[8]) * 180 / Math.PI).toFixed(2)}°`);
    cell(this.rows, 'error', error === null ? 'truth unknown' : lengthText(error, app.metric, 2));
    cell(this.rows, 'echoes', Object.entries(REASONS).map(([name, text]) => `${this.counts[name] ?? 0} ${text}`).join(', '));
    cell(this.rows, 'waypoints', `${now.passed} of ${now.waypoints.length} reached`);
    const points = (pick) => this.moments.flatMap((moment) => moment.echoes.filter((echo) => echo.refusal === 'none')
      .map((echo) => [moment.time_s, pick(echo)]));
    const end = now.clock_s, theme = app.theme;
    chart(this.charts[0], theme, end, [{ points: points((echo) => echo.innovation_in), colour: theme.estimate, dots: true }]);
    chart(this.charts[1], theme, end, [{ points: points((echo) => echo.nis), colour: theme.estimate, dots: true }], GATE_99_9);
    chart(this.charts[2], theme, end, [
      { points: this.moments.filter((moment) => moment.error !== null).map((moment) => [moment.time_s, moment.error]), colour: theme.hit },
      { points: this.moments.map((moment) => [moment.time_s, moment.sigma]), colour: theme.quiet }]);
  },
  draw(pen, scene, view, { theme }) {
    const now = this.latest;
    if (!now) return;
    const body = scene.bodies[String(now.robot)];
    for (const beam of this.beams.values()) drawBeam(pen, view, beam, body?.ring_in ?? 9, theme);
    drawEllipse(pen, view, now, theme);
    pen.strokeStyle = pen.fillStyle = theme.estimate;
    pen.lineWidth = 2;
    arrow(pen, view, ...now.pose, body?.radius_in ?? 9);
    if (now.waypoints.length) drawWaypoints(pen, now.waypoints, view, theme);
  },
};

function errorOf(message) {
  return message.truth && Math.hypot(message.pose[0] - message.truth[0], message.pose[1] - message.truth[1]);
}

// Three sigma along the longest axis of the ellipse.
function sigmaOf(message) { return 3 * ellipse(message.cov)[0]; }

// Half axes (standard deviations) and direction of the ellipse of a covariance, row by row of 3 x 3.
export function ellipse([xx, xy, , , yy]) {
  const middle = (xx + yy) / 2, apart = Math.hypot((xx - yy) / 2, xy);
  return [Math.sqrt(Math.max(middle + apart, 0)), Math.sqrt(Math.max(middle - apart, 0)), 0.5 * Math.atan2(2 * xy, xx - yy)];
}

function drawEllipse(pen, view, { pose, cov }, theme) {
  const [long, short, turn] = ellipse(cov), [px, py] = toScreen(view, pose[0], pose[1]);
  pen.strokeStyle = theme.estimate;
  pen.lineWidth = 1.5;
  pen.beginPath();
  pen.ellipse(px, py, Math.max(3 * long * view.scale, 1), Math.max(3 * short * view.scale, 1), -turn, 0, 2 * Math.PI);
  pen.stroke();
}

function drawBeam(pen, view, beam, ring, theme) {
  const angle = beam.turret + beam.sonar * Math.PI / 8, used = beam.refusal === 'none';
  const [x, y] = beam.pose, far = ring + beam.reading_in, c = Math.cos(angle), s = Math.sin(angle);
  pen.strokeStyle = pen.fillStyle = used ? theme.good : theme.hit;
  pen.lineWidth = used ? 2 : 1;
  pen.setLineDash(used ? [] : [3, 4]);
  pen.beginPath();
  pen.moveTo(...toScreen(view, x + ring * c, y + ring * s));
  pen.lineTo(...toScreen(view, x + far * c, y + far * s));
  pen.stroke();
  pen.setLineDash([]);
  if (used) { circle(pen, view, x + far * c, y + far * s, 3 / view.scale); pen.fill(); return; }
  pen.font = '10px system-ui, sans-serif';
  const near = ring + Math.min(beam.reading_in, 24);
  pen.fillText(REASONS[beam.refusal], ...toScreen(view, x + near * c, y + near * s));
}

function chart(canvas, theme, end_s, lines, bound) {
  const pen = sizedPen(canvas, 0.3);
  if (!pen) return;
  const values = lines.flatMap(({ points }) => points.map(([, value]) => value)).concat(bound ?? []);
  const low = Math.min(0, ...values), high = Math.max(1e-3, ...values), left = 34, wide = pen.width - left - 4;
  const at = (time_s, value) => [left + wide * (1 - (end_s - time_s) / KEPT_S),
    pen.height - 8 - (value - low) / (high - low) * (pen.height - 16)];
  pen.strokeStyle = theme.edge;
  pen.fillStyle = theme.quiet;
  pen.font = '10px system-ui, sans-serif';
  for (const value of [low, high, 0, ...(bound ? [bound] : [])]) {
    const [, py] = at(end_s, value);
    pen.beginPath(); pen.moveTo(left, py); pen.lineTo(pen.width, py); pen.stroke();
    pen.fillText(value.toFixed(1), 2, py + 3);
  }
  for (const { points, colour, dots } of lines) {
    pen.strokeStyle = pen.fillStyle = colour;
    pen.beginPath();
    points.forEach(([time_s, value], k) => {
      const [px, py] = at(time_s, value);
      if (dots) pen.fillRect(px - 1, py - 1, 2, 2); else (k ? pen.lineTo : pen.moveTo).call(pen, px, py);
    });
    pen.stroke();
  }
}
