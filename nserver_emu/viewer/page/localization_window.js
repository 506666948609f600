// The window Localization and the estimate on the map, from a localizer that this page started or from
// `nomad localize --publish`, for the selected robot: a ghost robot with its 3-sigma ellipse, used and refused beams with
// the reason, innovation, NIS and error over time, waypoints. Old data is marked and then fades. For a robot that is LOST,
// no pose is shown, only the possible ones with their probabilities.

import { toScreen } from './geometry.js';
import { circle, arrow } from './draw.js';
import { drawWaypoints, remainingWaypoints, roundToTenths } from './tools.js';
import { chart, legend } from './charts.js';
import { isActive, localizerControls } from './localizer_controls.js';
import { linkWith } from './menus.js';
import { cell, table, element, button, form, lengthField } from './widgets.js';
import { lengthText, degreesText, unitIn, unitName } from './units.js';

const HISTORY_S = 120, BEAM_S = 1, STALE_S = 5, MAX_AGE_S = 60;
const GATE_99_9 = 10.828;  // 99.9 % quantile of chi-squared with one degree of freedom
const REASONS = { none: 'used', limit: 'at sensor limit', no_wall: 'no wall', ambiguous_wall: 'ambiguous wall',
  grazing: 'grazing', gate: 'outside gate' };
const CHARTS = {
  innovation: ['Innovation', [['estimate', 'used'], ['hit', 'refused']]],
  nis: ['NIS', [['estimate', 'used'], ['hit', 'refused, and the 99.9 % bound']]],
  error: ['Position error', [['hit', 'error'], ['estimate', '3 sigma, major axis']]],
  heading: ['Heading error, °', [['hit', 'error'], ['estimate', '3 sigma']]],
};
const DEGREES = 180 / Math.PI;
const TRUST = { OK: '✓ OK', DEGRADED: '! DEGRADED', LOST: '✕ LOST', OLD: '– OLD', STARTING: '… STARTING', FAILED: '✕ FAILED', OFF: '– OFF' };
const UNKNOWN = { error: null, sigma: null, turn: null, turnSigma: null };

function newHistory() { return { latest: null, received_ms: 0, received_s: 0, samples: [], beams: new Map(), counts: {} }; }

export const localizationWindow = {
  id: 'localization', title: 'Localization', of: {}, runs: {},
  build(box, app) {
    this.note = element('p', { className: 'quiet' });
    this.onMap = document.getElementById('map-trust');
    this.trust = element('strong', { role: 'status', id: 'trust' });
    this.reason = element('span', { id: 'trust-reason' });
    this.state = element('p', { className: 'trust' }, element('i', { className: 'lamp' }), this.trust, ' ', this.reason);
    this.mapNote = element('p', { id: 'map-note', className: 'error', role: 'status' });
    this.controls = localizerControls(app, () => this.runs[app.robot]);
    this.rows = table(box, 'Estimate');
    this.charts = Object.fromEntries(Object.entries(CHARTS).map(([name, [title, entries]]) => {
      const canvas = element('canvas', { role: 'img' }), heading = element('div');
      canvas.setAttribute('aria-label', `${title} of the last ${HISTORY_S} seconds`);
      return [name, { canvas, heading, title, whole: element('div', {}, heading, canvas, legend(...entries)) }];
    }));
    this.plots = element('div', {}, ...Object.values(this.charts).map(({ whole }) => whole));
    box.prepend(this.state, this.mapNote, this.controls.box, this.note);
    box.append(this.plots, this.waypoints(app));
  },
  waypoints(app) {
    this.point = [lengthField(app, 'x', 0, { id: 'waypoint-x' }), lengthField(app, 'y', 0, { id: 'waypoint-y' })];
    this.list = element('div', { id: 'waypoint-list' });
    return element('div', { className: 'acts', role: 'group', ariaLabel: 'Waypoints' },
      form(() => app.setWaypoints([...remainingWaypoints(app), roundToTenths(this.point.map(({ inches }) => inches))]),
        element('div', { className: 'row' }, ...this.point.map(({ label }) => label), element('button', { id: 'add-waypoint' }, 'Add waypoint'))),
      element('div', { className: 'row' },
        button('Clear waypoints', () => app.setWaypoints([]), { id: 'clear-waypoints' })),
      this.list);
  },
  reset() { this.of = {}; this.runs = {}; },
  onMessage(message, app) {
    if (message.type === 'localizers') this.onLocalizers(message.robots, app);
    if (message.type !== 'localization') return;
    // An older clock means that another localizer has started.
    const old = this.of[message.robot];
    const own = this.of[message.robot] = old && message.clock_s >= old.latest.clock_s ? old : newHistory();
    own.latest = message;
    own.received_ms = performance.now() - 1000 * (message.age_s ?? 0);
    own.received_s = app.scene.time_s;
    if (isLost(message)) own.beams.clear();
    for (const echo of message.echoes) {
      own.counts[echo.refusal] = (own.counts[echo.refusal] ?? 0) + 1;
      own.beams.delete(echo.sonar);
      if (!isLost(message)) own.beams.set(echo.sonar, { ...echo, pose: message.pose, turret: message.turret, clock_s: message.clock_s });
    }
    for (const [sonar, beam] of own.beams) if (beam.clock_s < message.clock_s - BEAM_S) own.beams.delete(sonar);
    own.samples.push({ time_s: message.clock_s, echoes: message.echoes, ...errorsOf(message) });
    while (own.samples[0].time_s < message.clock_s - HISTORY_S) own.samples.shift();
    app.map.requestRedraw();
    app.requestUpdate();
  },
  // The states of the localizers that pages started: {method, state, words, has_old_map} by robot.
  onLocalizers(robots, app) {
    for (const [id, run] of Object.entries(robots)) {
      const old = this.runs[id], isSame = run.state === old?.state && run.words === old.words;
      this.runs[id] = { ...run, at_ms: isSame ? old.at_ms : performance.now() };
    }
    app.requestUpdate();
  },
  // Return the latest message of a robot's localizer, or null if it is old. In a replay no data is old.
  currentEstimate(id) {
    const own = this.of[id];
    return own && ageOf(own) < STALE_S ? own.latest : null;
  },
  update(app) {
    const own = this.of[app.robot], age_s = own && ageOf(own);
    this.listWaypoints(app);
    this.plots.hidden = this.rows.parentElement.hidden = !own;
    this.note.hidden = Boolean(own);
    this.controls.update();
    this.showHealth(...healthOf(own, age_s, this.runs[app.robot]));
    this.showMapNote(this.runs[app.robot]);
    if (!own) { this.showCommand(app); return; }
    if (age_s > STALE_S) app.map.requestRedraw();
    this.updateTexts(own, app);
    this.updateCharts(own, app);
  },
  showHealth(trust, reason) {
    if (this.trust.textContent !== TRUST[trust]) this.trust.textContent = TRUST[trust];
    this.state.dataset.trust = this.onMap.dataset.trust = trust;
    this.onMap.lastChild.textContent = TRUST[trust];
    this.onMap.hidden = trust === 'OFF';
    if (this.reason.textContent !== reason) this.reason.textContent = reason;
  },
  showMapNote(run) {
    const text = isActive(run) && run.has_old_map ? 'The world has changed since this localizer was started; its map has not. Localize starts it with the new map.' : '';
    if (this.mapNote.textContent !== text) this.mapNote.textContent = text;
  },
  showCommand(app) {
    const line = publishCommand(app), key = line ?? 'none';
    if (this.shownCommand === key && this.note.firstChild) return;
    this.shownCommand = key;
    this.note.replaceChildren(`No localizer publishes an estimate of robot ${app.robot}. `, ...(line ? ['The same in a terminal: ', element('code', {}, line)] : []));
  },
  updateTexts({ latest: now, counts }, app) {
    this.shownCommand = null;
    const { error, sigma, turn, turnSigma } = errorsOf(now), lost = isLost(now);
    const at = ([px, py, turned]) => `${lengthText(px, app.metric, 2)}, ${lengthText(py, app.metric, 2)}, ${degreesText(turned)}`;
    cell(this.rows, 'estimate', lost ? 'none' : at(now.pose));
    cell(this.rows, 'alternatives', alternatives(now).map(({ pose, share }) => `${percent(share)}: ${at(pose)}`).join('; ') || (lost ? 'none found yet' : 'no other pose'));
    cell(this.rows, '3 sigma', lost ? 'unknown' : `${lengthText(sigma, app.metric, 2)}, ${turnSigma.toFixed(2)}°`);
    cell(this.rows, 'error', lost ? 'unknown' : error === null ? 'ground truth not available' : `${lengthText(error, app.metric, 2)}, ${turn.toFixed(2)}°`);
    cell(this.rows, 'echoes', Object.entries(REASONS).map(([name, text]) => `${counts[name] ?? 0} ${text}`).join(', '));
    cell(this.rows, 'waypoints', `${now.passed} of ${now.waypoints.length} reached`);
  },
  updateCharts({ latest, samples, received_s }, app) {
    const { theme } = app, one = unitIn(app.metric), unit = unitName(app.metric);
    const dots = (used, pick) => ({ dots: true, colour: used ? theme.estimate : theme.hit, points: samples.flatMap((sample) => sample.echoes
      .filter((echo) => (echo.refusal === 'none') === used && (used || echo.nis > 0)).map((echo) => [sample.time_s, pick(echo)])) });
    const line = (pick) => ({ colour: theme.hit, points: samples.map((sample) => [sample.time_s, pick(sample)]) });
    const band = (low, high) => ({ colour: theme.estimate, points: samples.map((sample) => [sample.time_s, low(sample), high(sample)]) });
    const scaled = (length) => (length === null ? null : length / one);
    const lines = {
      innovation: [dots(false, (echo) => echo.innovation_in / one), dots(true, (echo) => echo.innovation_in / one)],
      nis: [dots(false, (echo) => Math.min(echo.nis, 2 * GATE_99_9)), dots(true, (echo) => echo.nis)],
      error: [line((sample) => scaled(sample.error))],
      heading: [line((sample) => sample.turn)],
    };
    const bands = {
      error: [band((sample) => (sample.sigma === null ? null : 0), (sample) => scaled(sample.sigma))],
      heading: [band((sample) => (sample.turnSigma === null ? null : -sample.turnSigma), (sample) => sample.turnSigma)],
    };
    // Time goes on without messages: then the charts have a gap at their right end.
    const end_s = latest.clock_s + Math.max(0, app.scene.time_s - received_s);
    for (const [name, { canvas, heading, title }] of Object.entries(this.charts)) {
      const text = ['innovation', 'error'].includes(name) ? `${title}, ${unit}` : title;
      if (heading.textContent !== text) heading.textContent = text;
      chart(canvas, theme, { end_s, span_s: chartSpan([...samples, { time_s: end_s }]), lines: lines[name], bands: bands[name], bound: name === 'nis' ? GATE_99_9 : undefined });
    }
  },
  listWaypoints(app) {
    const points = remainingWaypoints(app), key = JSON.stringify([points, app.metric]);
    if (this.listed === key) return;
    this.listed = key;
    const focused = document.activeElement?.dataset?.waypoint;
    this.list.replaceChildren(...points.map(([x, y], k) => {
      const remove = button('Delete', () => app.setWaypoints(remainingWaypoints(app).filter((_, j) => j !== k)), { ariaLabel: `Delete waypoint ${k + 1}` });
      remove.dataset.waypoint = k;
      return element('div', { className: 'row' }, element('span', {}, `${k + 1}: ${lengthText(x, app.metric)}, ${lengthText(y, app.metric)}`), remove);
    }));
    if (focused) this.list.querySelector(`[data-waypoint="${focused}"]`)?.focus();
  },
  draw(pen, scene, view, { theme }, app) {
    const own = this.of[app.robot];
    const points = remainingWaypoints(app);
    if (points.length && !(app.toolName === 'waypoint' && app.map.dragged === 'tool')) drawWaypoints(pen, points, view, theme);
    if (!own || ageOf(own) > MAX_AGE_S) return;
    const now = own.latest, body = scene.bodies[String(now.robot)], old = healthOf(own, ageOf(own), this.runs[app.robot])[0] === 'OLD';
    if (!body) return;
    pen.globalAlpha = old ? 0.35 : 1;
    if (!old) for (const beam of own.beams.values()) drawBeam(pen, view, beam, body, theme);
    if (!isLost(now)) { drawGhost(pen, view, now, body, theme); drawEllipse(pen, view, now, theme); }
    for (const place of alternatives(now)) drawAlternative(pen, view, place, body.radius_in, theme);
    pen.setLineDash([2, 3]);
    pen.strokeStyle = theme.encoder;
    pen.lineWidth = 1.5;
    circle(pen, view, now.odometry[0], now.odometry[1], 3 / view.scale);
    pen.stroke();
    pen.setLineDash(old ? [4, 4] : []);
    pen.strokeStyle = pen.fillStyle = theme.estimate;
    pen.lineWidth = 2;
    if (!isLost(now)) arrow(pen, view, ...now.pose, body.ring_in);
    pen.setLineDash([]);
    pen.globalAlpha = 1;
  },
};

// Return the health that is shown, [name in TRUST, reason], from the data of a robot, its age, and the localizer that a page
// started for it. A localizer that has ended or is silent has no health: what is shown is old.
export function healthOf(own, age_s, run) {
  const isNewer = own && (!run || own.received_ms > run.at_ms);
  if (run?.state === 'starting') return ['STARTING', run.words || 'the localizer starts, which takes some seconds'];
  if (run?.state === 'failed' && !isNewer) return ['FAILED', run.words];
  if (!own) return ['OFF', run ? run.words : 'no localizer runs: press Localize'];
  if (run?.state === 'ended' && !isNewer) return ['OLD', `the localizer has ended (${run.words}): the data shown is old`];
  if (age_s > STALE_S) return ['OLD', `no message from the localizer for ${Math.round(age_s)} s: the data shown is old`];
  return [own.latest.trust ?? 'OK', own.latest.reason ?? ''];
}

function isLost({ trust }) { return trust === 'LOST'; }

// Return the possible poses if there are several; a single one is the estimate.
function alternatives({ places = [] }) { return places.length > 1 ? places : []; }

export function percent(fraction) { return fraction > 0 && fraction < 0.005 ? 'under 1 %' : `${Math.round(100 * fraction)} %`; }

function ageOf(own) { return window.nserverRun ? 0 : (performance.now() - own.received_ms) / 1000; }

// Return the time span of the charts, so that the available data fills them.
export function chartSpan(samples) {
  const available_s = samples.length ? samples[samples.length - 1].time_s - samples[0].time_s : 0;
  return [15, 30, 60].find((span_s) => available_s <= span_s) ?? HISTORY_S;
}

// Return the command that publishes to this page; null on read-only pages, which must not show the token.
function publishCommand(app) {
  if (!app.mayAct || window.nserverRun) return null;
  const address = app.lines.nserver ?? 'localhost:7019';
  return `nomad localize nserver://${address}/${app.robot} --map ${app.scene.world?.name ?? 'WORLD'} --publish '${linkWith(location, app.token)}'`;
}

// Return errors against the ground truth (null without it) and 3 sigma: of the position in inches, of the heading in degrees.
// All are null for a robot that is lost.
export function errorsOf({ pose, truth, cov, trust }) {
  if (isLost({ trust })) return UNKNOWN;
  // The heading error is wrapped to -180 .. 180 degrees.
  const turn = truth && (((pose[2] - truth[2]) * DEGREES + 540) % 360 + 360) % 360 - 180;
  return { error: truth && Math.hypot(pose[0] - truth[0], pose[1] - truth[1]), turn, sigma: 3 * ellipse(cov)[0],
    turnSigma: 3 * Math.sqrt(cov[8]) * DEGREES };
}

// Return the half axes (standard deviations) and the direction of the position ellipse, from the eigenvalues of the upper
// left 2 x 2 block of a 3 x 3 covariance in rows.
export function ellipse([xx, xy, , , yy]) {
  const mean = (xx + yy) / 2, radius = Math.hypot((xx - yy) / 2, xy);
  return [Math.sqrt(Math.max(mean + radius, 0)), Math.sqrt(Math.max(mean - radius, 0)), 0.5 * Math.atan2(2 * xy, xx - yy)];
}

// Draw the estimate as a robot that one can look through.
function drawGhost(pen, view, { pose: [x, y], turret }, { radius_in: radius, differential }, theme) {
  const alpha = pen.globalAlpha;
  pen.strokeStyle = pen.fillStyle = theme.estimate;
  pen.lineWidth = 1.5;
  circle(pen, view, x, y, radius);
  pen.globalAlpha = 0.12 * alpha; pen.fill(); pen.globalAlpha = alpha;
  pen.stroke();
  if (differential) return;
  pen.beginPath();
  pen.moveTo(...toScreen(view, x + 0.55 * radius * Math.cos(turret), y + 0.55 * radius * Math.sin(turret)));
  pen.lineTo(...toScreen(view, x + radius * Math.cos(turret), y + radius * Math.sin(turret)));
  pen.stroke();
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

// Draw a possible pose, more strongly the more probable it is, with its probability.
function drawAlternative(pen, view, { pose, share }, radius, theme) {
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

function drawBeam(pen, view, beam, { ring_in: ring, sonars }, theme) {
  if (beam.sonar >= sonars.angles.length) return;  // the localizer has a model with more sonars
  const angle = beam.turret + sonars.angles[beam.sonar], used = beam.refusal === 'none';
  const far = ring + beam.reading_in, c = Math.cos(angle), s = Math.sin(angle);
  const [forwards, left] = sonars.shifts[beam.sonar] ?? [0, 0];
  const x = beam.pose[0] + forwards * c - left * s, y = beam.pose[1] + forwards * s + left * c;
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
