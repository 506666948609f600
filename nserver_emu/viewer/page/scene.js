// The state of the simulation, assembled from the pictures that the server sends. No drawing, no socket, no DOM.
// A picture with `since` 0 is complete; any other contains the changes since the one before.

export const HISTORY_S = 60;
export const MAX_TRACE_NUMBERS = 8000;
const MAX_SAMPLES = 1500;

export function emptyScene() {
  return {
    frame: 0, time_s: 0, speed: 1, paused: false, lockstep_s: null, robots: {}, walkers: [], bodies: {}, world: null,
    graphics: [], traces: {}, beams: {}, lasers: {}, laser_modes: {}, speech: [], history: {},
  };
}

// Parts of every picture; `robots` and `walkers` may be as before, and time is not drawn.
const FIXED_PARTS = new Set(['type', 'frame', 'since', 'time_s', 'speed', 'paused', 'lockstep_s', 'robots', 'walkers']);

// Return true if the picture changes anything that the map shows.
export function changesMap(scene, picture) {
  return Object.keys(picture).some((part) => !FIXED_PARTS.has(part))
    || JSON.stringify([scene.robots, scene.walkers]) !== JSON.stringify([picture.robots, picture.walkers ?? []]);
}

export function applyPicture(scene, picture) {
  if (picture.since === 0) {
    scene.traces = {};
    scene.beams = {};
    if (picture.time_s < scene.time_s) scene.history = {};
  }
  for (const key of ['frame', 'time_s', 'speed', 'paused', 'lockstep_s', 'robots']) scene[key] = picture[key];
  for (const key of ['bodies', 'world', 'graphics', 'lasers', 'laser_modes']) if (key in picture) scene[key] = picture[key];
  scene.walkers = picture.walkers ?? [];
  if ('said' in picture) scene.speech = picture.said;  // texts of tk: [time_s, robot, text]
  if ('drawn' in picture) scene.graphics = updateShapes(scene.graphics, picture.drawn);
  for (const [id, both] of Object.entries(picture.traces ?? {})) {
    const own = scene.traces[id] ??= { actual: newTrace(), encoder: newTrace() };
    appendTrace(own.actual, both.actual);
    appendTrace(own.encoder, both.encoder);
  }
  scene.beams = updateBeams(scene.beams, picture.beams);
  for (const [id, robot] of Object.entries(scene.robots)) addSample(scene, id, robot);
}

// Return the client graphics without those that are `gone` and with those that `come`.
export function updateShapes(shapes, { gone, come }) {
  const removed = new Set(gone);
  return [...(removed.size ? shapes.filter(([number]) => !removed.has(number)) : shapes), ...come];
}

// Return the sonar beams by robot after changes: [sonar, x, y, direction] at the time of the ping; [sonar] removes one.
export function updateBeams(beams, changed = {}) {
  const updated = { ...beams };
  for (const [id, come] of Object.entries(changed)) {
    const replaced = new Set(come.map(([sonar]) => sonar));
    updated[id] = [...(updated[id] ?? []).filter(([sonar]) => !replaced.has(sonar)), ...come.filter((beam) => beam.length > 1)];
  }
  return updated;
}

function newTrace() { return { gone: 0, points: [] }; }

function appendTrace(trace, more) {
  trace.points.push(...more.points);
  if (trace.points.length > MAX_TRACE_NUMBERS) trace.points.splice(0, trace.points.length - MAX_TRACE_NUMBERS);
  trace.gone = more.gone;
}

function addSample(scene, id, robot) {
  const samples = scene.history[id] ??= [];
  const last = samples[samples.length - 1];
  if (last && scene.time_s <= last.time_s) return;
  samples.push({ time_s: scene.time_s, sonars: sonarReadings(robot, scene.bodies[id]) });
  while (samples.length > MAX_SAMPLES || samples[0].time_s < scene.time_s - HISTORY_S) samples.shift();
}

// Return the readings of all sonars of a robot: those of State, or `sonars` where State has no room for them.
export function sonarReadings(robot, body) { return robot.sonars ?? robot.state.slice(17, 17 + body.sonars.angles.length); }

export function isEcho(reading, { max_in, no_echo_in }) { return reading < max_in && reading !== no_echo_in; }

// Return the range at which a reading is drawn: without an echo the maximum, whichever number the ring reads then.
export function shownRange(reading, ring) { return isEcho(reading, ring) ? reading : ring.max_in; }

export function infraredAngle(number) { return number * Math.PI / 8; }

// Return the bounding box of walls, obstacles and robots.
export function worldBounds(scene) {
  const xs = [], ys = [];
  const add = (x, y) => { xs.push(x); ys.push(y); };
  for (const [x1, y1, x2, y2] of scene.world?.walls ?? []) { add(x1, y1); add(x2, y2); }
  for (const { corners } of scene.world?.obstacles ?? []) for (const [x, y] of corners) add(x, y);
  for (const robot of Object.values(scene.robots)) add(robot.actual[0], robot.actual[1]);
  if (!xs.length) return [-60, -60, 60, 60];
  return [Math.min(...xs), Math.min(...ys), Math.max(...xs), Math.max(...ys)];
}
