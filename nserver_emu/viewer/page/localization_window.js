// The window Localization, and the estimate on the map: what `nomad localize --publish` says of the robot that is chosen.
// Where it is thought to be with its 3-sigma ellipse, the beams taken and refused with the reason, innovation, NIS and
// error over time, way-points. Rules: what has not been heard of for a while says so, and then fades; of a robot that is
// LOST no place is shown as its own, only the several that it may be at, each with its share.

import { toScreen } from './view.js';
import { circle, arrow } from './draw.js';
import { drawWaypoints, pointsNow, tenthed } from './tools.js';
import { chart, legend } from './charts.js';
import { linkWith } from './share.js';
import { cell, table, element, button, form, lengthField } from './parts.js';
import { lengthText, degreesText, unitIn, unitName } from './units.js';

const KEPT_S = 120, BEAM_S = 1, GATE_99_9 = 10.828, STALE_S = 5, GONE_S = 60;
export const REASONS = { none: 'used', limit: 'a limit', no_wall: 'no wall there', ambiguous_wall: 'which wall?',
  grazing: 'grazing', gate: 'beyond the gate' };
const CHARTS = {
  innovation: ['Innovation', [['estimate', 'used'], ['hit', 'refused']]],
  nis: ['NIS', [['estimate', 'used'], ['hit', 'refused, and the bound that one in a thousand passes']]],
  error: ['Error of the place', [['hit', 'error'], ['quiet', '3 sigma, the long axis']]],
  heading: ['Error of the heading, °', [['hit', 'error'], ['quiet', '3 sigma']]],
};
const DEGREES = 180 / Math.PI;
const TRUST = { OK: '✓ OK', DEGRADED: '! DEGRADED', LOST: '✕ LOST' };
const UNKNOWN = { error: null, sigma: null, turn: null, turnSigma: null };

function newHistory() { return { latest: null, heard_ms: 0, moments: [], beams: new Map(), counts: {} }; }

export const localizationWindow = {
  id: 'localization', title: 'Localization', of: {},
  build(box, app) {
    this.note = element('p', { className: 'quiet' });
    this.trust = element('strong', { role: 'status', id: 'trust' });
    this.reason = element('span', { id: 'trust-reason' });
    this.state = element('p', { className: 'trust' }, this.trust, ' ', this.reason);
    this.rows = table(box, 'Estimate');
    this.charts = Object.fromEntries(Object.entries(CHARTS).map(([name, [title, entries]]) => {
      const canvas = element('canvas', { role: 'img' }), heading = element('div');
      canvas.setAttribute('aria-label', `${title} over the last ${KEPT_S} seconds`);
      return [name, { canvas, heading, title, whole: element('div', {}, heading, canvas, legend(...entries)) }];
    }));
    this.plots = element('div', {}, ...Object.values(this.charts).map(({ whole }) => whole));
    box.prepend(this.note, this.state);
    box.append(this.plots, this.waypoints(app));
  },
  waypoints(app) {
    this.point = [lengthField(app, 'x', 0, { id: 'waypoint-x' }), lengthField(app, 'y', 0, { id: 'waypoint-y' })];
    this.list = element('div', { id: 'waypoint-list' });
    return element('div', { className: 'acts', role: 'group', ariaLabel: 'Waypoints' },
      form(() => app.setWaypoints([...pointsNow(app), tenthed(this.point.map((one) => one.inches))]),
        element('div', { className: 'row' }, ...this.point.map((one) => one.label), element('button', { id: 'add-waypoint' }, 'Add waypoint'))),
      element('div', { className: 'row' }, button('By pointer', () => app.choose('waypoint'), { ariaLabel: 'Waypoints by pointer' }),
        button('Clear waypoints', () => app.setWaypoints([]), { id: 'clear-waypoints' })),
      this.list);
  },
  reset() { this.of = {}; },
  hear(message, app) {
    if (message.type !== 'localization') return;
    const old = this.of[message.robot];
    const mine = this.of[message.robot] = old && message.clock_s >= old.latest.clock_s ? old : newHistory();
    mine.latest = message;
    mine.heard_ms = performance.now() - 1000 * (message.age_s ?? 0);
    if (isLost(message)) mine.beams.clear();
    for (const echo of message.echoes) {
      mine.counts[echo.refusal] = (mine.counts[echo.refusal] ?? 0) + 1;
      mine.beams.delete(echo.sonar);
      if (!isLost(message)) mine.beams.set(echo.sonar, { ...echo, pose: message.pose, turret: message.turret, clock_s: message.clock_s });
    }
    for (const [sonar, beam] of mine.beams) if (beam.clock_s < message.clock_s - BEAM_S) mine.beams.delete(sonar);
    mine.moments.push({ time_s: message.clock_s, echoes: message.echoes, ...errorsOf(message) });
    while (mine.moments[0].time_s < message.clock_s - KEPT_S) mine.moments.shift();
    app.map.keepDrawing();
    app.changed();
  },
  // The latest message of a robot's localizer, unless it has been silent; in a replay nothing grows old.
  alive(id) {
    const mine = this.of[id];
    return mine && ageOf(mine) < STALE_S ? mine.latest : null;
  },
  update(app) {
    const mine = this.of[app.robot], age_s = mine && ageOf(mine);
    this.listWaypoints(app);
    this.plots.hidden = this.rows.parentElement.hidden = this.state.hidden = !mine;
    this.note.hidden = Boolean(mine) && age_s < STALE_S;
    if (!mine) { this.tellHow(app); return; }
    if (!this.note.hidden) this.note.textContent = `Nothing heard of the localizer for ${Math.round(age_s)} s: what is shown is old.`;
    if (age_s > STALE_S) app.map.keepDrawing();
    this.words(mine, app);
    this.draws(mine, app);
  },
  tellHow(app) {
    const line = howToPublish(app), key = line ?? 'none';
    if (this.told === key && this.note.firstChild) return;
    this.told = key;
    this.note.replaceChildren(`Nobody publishes an estimate of robot ${app.robot}. `, ...(line ? ['In a terminal: ', element('code', {}, line)] : []));
  },
  words({ latest: now, counts }, app) {
    this.told = null;
    const { error, sigma, turn, turnSigma } = errorsOf(now), lost = isLost(now), trust = now.trust ?? 'OK';
    if (this.trust.textContent !== TRUST[trust]) this.trust.textContent = TRUST[trust];
    this.state.dataset.trust = trust;
    this.reason.textContent = now.reason ?? '';
    const at = ([px, py, turned]) => `${lengthText(px, app.metric, 2)}, ${lengthText(py, app.metric, 2)}, ${degreesText(turned)}`;
    cell(this.rows, 'estimate', lost ? 'none is believed' : at(now.pose));
    cell(this.rows, 'may be at', severalOf(now).map(({ pose, share }) => `${percent(share)}: ${at(pose)}`).join('; ') || (lost ? 'anywhere' : 'there alone'));
    cell(this.rows, '3 sigma', lost ? 'no place, no spread' : `${lengthText(sigma, app.metric, 2)}, ${turnSigma.toFixed(2)}°`);
    cell(this.rows, 'error', lost ? 'no place, no error' : error === null ? 'truth unknown' : `${lengthText(error, app.metric, 2)}, ${turn.toFixed(2)}°`);
    cell(this.rows, 'echoes', Object.entries(REASONS).map(([name, text]) => `${counts[name] ?? 0} ${text}`).join(', '));
    cell(this.rows, 'waypoints', `${now.passed} of ${now.waypoints.length} reached`);
  },
  draws({ latest, moments }, app) {
    const { theme } = app, one = unitIn(app.metric), unit = unitName(app.metric);
    const dots = (used, pick) => ({ dots: true, colour: used ? theme.estimate : theme.hit, points: moments.flatMap((moment) => moment.echoes
      .filter((echo) => (echo.refusal === 'none') === used && (used || echo.nis > 0)).map((echo) => [moment.time_s, pick(echo)])) });
    const line = (colour, pick) => ({ colour, points: moments.filter((moment) => pick(moment) !== null).map((moment) => [moment.time_s, pick(moment)]) });
    const lines = {
      innovation: [dots(false, (echo) => echo.innovation_in / one), dots(true, (echo) => echo.innovation_in / one)],
      nis: [dots(false, (echo) => Math.min(echo.nis, 2 * GATE_99_9)), dots(true, (echo) => echo.nis)],
      error: [line(theme.quiet, (moment) => moment.sigma && moment.sigma / one), line(theme.hit, (moment) => moment.error && moment.error / one)],
      heading: [line(theme.quiet, (moment) => moment.turnSigma), line(theme.hit, (moment) => moment.turn && Math.abs(moment.turn))],
    };
    for (const [name, { canvas, heading, title }] of Object.entries(this.charts)) {
      const text = ['innovation', 'error'].includes(name) ? `${title}, ${unit}` : title;
      if (heading.textContent !== text) heading.textContent = text;
      chart(canvas, theme, { end_s: latest.clock_s, span_s: spanOf(moments), lines: lines[name], bound: name === 'nis' ? GATE_99_9 : undefined });
    }
  },
  listWaypoints(app) {
    const points = pointsNow(app), key = JSON.stringify([points, app.metric]);
    if (this.listed === key) return;
    this.listed = key;
    const focused = document.activeElement?.dataset?.waypoint;
    this.list.replaceChildren(...points.map(([x, y], k) => {
      const gone = button('Delete', () => app.setWaypoints(pointsNow(app).filter((_, j) => j !== k)), { ariaLabel: `Delete waypoint ${k + 1}` });
      gone.dataset.waypoint = k;
      return element('div', { className: 'row' }, element('span', {}, `${k + 1}: ${lengthText(x, app.metric)}, ${lengthText(y, app.metric)}`), gone);
    }));
    if (focused) this.list.querySelector(`[data-waypoint="${focused}"]`)?.focus();
  },
  draw(pen, scene, view, { theme }, app) {
    const mine = this.of[app.robot];
    const points = pointsNow(app);
    if (points.length && !(app.toolName === 'waypoint' && app.map.dragged === 'tool')) drawWaypoints(pen, points, view, theme);
    if (!mine || ageOf(mine) > GONE_S) return;
    const now = mine.latest, ring = scene.bodies[String(now.robot)]?.ring_in ?? 9, old = ageOf(mine) > STALE_S;
    pen.globalAlpha = old ? 0.35 : 1;
    if (!old) for (const beam of mine.beams.values()) drawBeam(pen, view, beam, ring, theme);
    if (!isLost(now)) drawEllipse(pen, view, now, theme);
    for (const place of severalOf(now)) drawPlace(pen, view, place, scene.bodies[String(now.robot)]?.radius_in ?? ring, theme);
    pen.setLineDash([2, 3]);
    pen.strokeStyle = theme.encoder;
    pen.lineWidth = 1.5;
    circle(pen, view, now.odometry[0], now.odometry[1], 3 / view.scale);
    pen.stroke();
    pen.setLineDash(old ? [4, 4] : []);
    pen.strokeStyle = pen.fillStyle = theme.estimate;
    pen.lineWidth = 2;
    if (!isLost(now)) arrow(pen, view, ...now.pose, ring);
    pen.setLineDash([]);
    pen.globalAlpha = 1;
  },
};

function isLost({ trust }) { return trust === 'LOST'; }

// The places that it may be at, where they are several; one alone is the estimate.
function severalOf({ places = [] }) { return places.length > 1 ? places : []; }

export function percent(share) { return share > 0 && share < 0.005 ? 'under 1 %' : `${Math.round(100 * share)} %`; }

function ageOf(mine) { return window.nserverRun ? 0 : (performance.now() - mine.heard_ms) / 1000; }

// How many seconds the charts show, so that what there is fills them.
export function spanOf(moments) {
  const known_s = moments.length ? moments[moments.length - 1].time_s - moments[0].time_s : 0;
  return [15, 30, 60].find((span_s) => known_s <= span_s) ?? KEPT_S;
}

// The command that publishes here, for who may act; null for who may not know the token.
export function howToPublish(app) {
  if (!app.mayAct || window.nserverRun) return null;
  const place = app.lines.nserver ?? 'localhost:7019';
  return `nomad localize nserver://${place}/${app.robot} --map ${app.scene.world?.name ?? 'WORLD'} --publish '${linkWith(location, app.token)}'`;
}

// Error against truth (null where that is unknown, all of it where no place is believed) and 3 sigma, of the place in inches, of the heading in degrees.
export function errorsOf({ pose, truth, cov, trust }) {
  if (isLost({ trust })) return UNKNOWN;
  const turn = truth && (((pose[2] - truth[2]) * DEGREES + 540) % 360 + 360) % 360 - 180;
  return { error: truth && Math.hypot(pose[0] - truth[0], pose[1] - truth[1]), turn, sigma: 3 * ellipse(cov)[0],
    turnSigma: 3 * Math.sqrt(cov[8]) * DEGREES };
}

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
  pen.fillStyle = theme.estimate;
  const alpha = pen.globalAlpha;
  pen.globalAlpha = 0.25 * alpha; pen.fill(); pen.globalAlpha = alpha;
  pen.stroke();
}

// Faint, the likelier the less so; its share in full ink.
function drawPlace(pen, view, { pose, share }, radius, theme) {
  const [x, y] = pose, alpha = pen.globalAlpha;
  pen.strokeStyle = pen.fillStyle = theme.estimate;
  pen.lineWidth = 1.5;
  pen.globalAlpha = alpha * (0.35 + 0.5 * share);
  pen.setLineDash([4, 3]);
  circle(pen, view, x, y, radius);
  pen.stroke();
  pen.setLineDash([]);
  arrow(pen, view, ...pose, radius);
  pen.globalAlpha = alpha;
  pen.font = '12px system-ui, sans-serif';
  pen.fillText(percent(share), ...toScreen(view, x + radius * 0.75, y - radius * 1.1));
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
  pen.font = '11px system-ui, sans-serif';
  const near = ring + Math.min(beam.reading_in, 24);
  pen.fillText(REASONS[beam.refusal], ...toScreen(view, x + near * c, y + near * s));
}
