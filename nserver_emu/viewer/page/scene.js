// What the page knows of the simulation: pictures as they come, put together. No drawing, no socket, no DOM.
// Rules: a picture since 0 replaces everything; any other adds to the one before it.

export const HISTORY_S = 60;
const MOST_TRACE_NUMBERS = 8000;
const MOST_SAMPLES = 1500;

export function emptyScene() {
  return {
    frame: 0, time_s: 0, speed: 1, paused: false, lockstep_s: null, robots: {}, bodies: {}, world: null,
    graphics: [], traces: {}, beams: {}, lasers: {}, laser_modes: {}, said: [], history: {},
  };
}

export function applyPicture(scene, picture) {
  if (picture.since === 0) {
    scene.traces = {};
    scene.beams = {};
    if (picture.time_s < scene.time_s) scene.history = {};
  }
  for (const key of ['frame', 'time_s', 'speed', 'paused', 'lockstep_s', 'robots']) scene[key] = picture[key];
  for (const key of ['bodies', 'world', 'graphics', 'lasers', 'laser_modes', 'said']) if (key in picture) scene[key] = picture[key];
  if ('drawn' in picture) scene.graphics = drawnOn(scene.graphics, picture.drawn);
  for (const [id, both] of Object.entries(picture.traces ?? {})) {
    const mine = scene.traces[id] ??= { actual: newTrace(), encoder: newTrace() };
    growTrace(mine.actual, both.actual);
    growTrace(mine.encoder, both.encoder);
  }
  scene.beams = beamsOn(scene.beams, picture.beams);
  for (const [id, robot] of Object.entries(scene.robots)) remember(scene, id, robot);
}

// What clients drew, with what went since and what came.
export function drawnOn(shapes, { gone, come }) {
  const went = new Set(gone);
  return [...(went.size ? shapes.filter(([number]) => !went.has(number)) : shapes), ...come];
}

// Beams by robot, with those that changed: each as [sonar, x, y, direction] it left; [sonar] alone takes one away.
export function beamsOn(beams, changed = {}) {
  const now = { ...beams };
  for (const [id, come] of Object.entries(changed)) {
    const went = new Set(come.map(([sonar]) => sonar));
    now[id] = [...(now[id] ?? []).filter(([sonar]) => !went.has(sonar)), ...come.filter((beam) => beam.length > 1)];
  }
  return now;
}

function newTrace() { return { gone: 0, points: [] }; }

function growTrace(trace, more) {
  trace.points.push(...more.points);
  if (trace.points.length > MOST_TRACE_NUMBERS) trace.points.splice(0, trace.points.length - MOST_TRACE_NUMBERS);
  trace.gone = more.gone;
}

function remember(scene, id, robot) {
  const samples = scene.history[id] ??= [];
  const last = samples[samples.length - 1];
  if (last && scene.time_s <= last.time_s) return;
  samples.push({ time_s: scene.time_s, sonars: robot.state.slice(17, 33) });
  while (samples.length > MOST_SAMPLES || samples[0].time_s < scene.time_s - HISTORY_S) samples.shift();
}

export function sonarDirection(robot, number) { return robot.actual[3] + number * Math.PI / 8; }

export function worldBounds(scene) {
  const xs = [], ys = [];
  const note = (x, y) => { xs.push(x); ys.push(y); };
  for (const [x1, y1, x2, y2] of scene.world?.walls ?? []) { note(x1, y1); note(x2, y2); }
  for (const thing of scene.world?.obstacles ?? []) for (const [x, y] of thing.corners) note(x, y);
  for (const robot of Object.values(scene.robots)) note(robot.actual[0], robot.actual[1]);
  if (!xs.length) return [-60, -60, 60, 60];
  return [Math.min(...xs), Math.min(...ys), Math.max(...xs), Math.max(...ys)];
}
