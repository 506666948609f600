// Draws a scene with a pen: the 2D context of a canvas, or an SvgPen. The world is in inches, the screen in CSS pixels.
// Nothing here changes scene, view or options.

import { innerWalls, toScreen, toWorld, roundLength, wallDistances, wallsWithin } from './geometry.js';
import { infraredAngle, isEcho, shownRange, sonarReadings } from './scene.js';
import { clientColour } from './colours.js';
import { unitIn, lengthText } from './units.js';

export const LAYERS = {
  grid: 'Grid', traces: 'Traces', encoder: 'Encoder robot', sonar: 'Sonar', infrared: 'Infrared', bumper: 'Bumpers',
  laser: 'Laser', graphics: 'Client graphics', estimate: 'Estimate',
};
const NO_INFRARED = 15;  // the reading without an obstacle
// Straight parts of the far end of a cone, and how far a ping may be from where the robot is now.
const CONE_RAYS = 12, BEAM_MARGIN_IN = 60;

export function drawScene(pen, scene, view, options) {
  const { theme, shown } = options;
  pen.fillStyle = theme.paper;
  pen.fillRect(0, 0, view.width, view.height);
  if (shown.grid) drawGrid(pen, view, options);
  if (!scene.world) return;
  drawWorld(pen, scene.world, view, options);
  drawDoors(pen, scene.world, view, options);
  drawWalkers(pen, scene, view, options);
  if (shown.graphics) options.graphics?.(pen, scene, view, options);
  const isFleet = Object.keys(scene.robots).length > 1;
  for (const [id, robot] of Object.entries(scene.robots)) {
    const body = scene.bodies[id];
    if (!body) continue;
    if (shown.traces) drawTraces(pen, scene.traces[id], view, theme);
    if (id === options.robot) drawSensors(pen, scene, id, view, options);
    if (shown.encoder) drawRobot(pen, robot.encoder, body, view, { colour: theme.encoder, dashed: true });
    drawRobot(pen, robot.actual, body, view, { colour: theme.actual, chosen: id === options.robot && isFleet });
    if (shown.bumper) drawBumpers(pen, robot, body, view, theme);
  }
  drawLabels(pen, scene, view, options);
  if (shown.estimate) options.estimate?.(pen, scene, view, options);
  options.tool?.(pen, scene, view, options);
  drawScale(pen, view, options);
}

function line(pen, view, x1, y1, x2, y2) {
  pen.beginPath();
  pen.moveTo(...toScreen(view, x1, y1));
  pen.lineTo(...toScreen(view, x2, y2));
  pen.stroke();
}

export function circle(pen, view, x, y, radius_in) {
  const [px, py] = toScreen(view, x, y);
  pen.beginPath();
  pen.arc(px, py, Math.max(radius_in * view.scale, 0.5), 0, 2 * Math.PI);
}

export function polygonPath(pen, view, corners) {
  pen.beginPath();
  corners.forEach(([x, y], k) => (k ? pen.lineTo : pen.moveTo).call(pen, ...toScreen(view, x, y)));
  pen.closePath();
}

function drawGrid(pen, view, { theme, metric }) {
  const step = roundLength(view.scale, 40, unitIn(metric));
  const [left, top] = toWorld(view, 0, 0), [right, bottom] = toWorld(view, view.width, view.height);
  pen.strokeStyle = theme.grid;
  pen.lineWidth = 1;
  pen.beginPath();
  for (let k = Math.ceil(left / step); k * step <= right; k += 1) {
    const [px] = toScreen(view, k * step, 0);
    pen.moveTo(px, 0); pen.lineTo(px, view.height);
  }
  for (let k = Math.ceil(bottom / step); k * step <= top; k += 1) {
    const [, py] = toScreen(view, 0, k * step);
    pen.moveTo(0, py); pen.lineTo(view.width, py);
  }
  pen.stroke();
}

function drawWorld(pen, world, view, { theme }) {
  for (const { corners } of world.obstacles) {
    polygonPath(pen, view, corners);
    pen.fillStyle = theme.obstacle;
    pen.globalAlpha = 0.35; pen.fill(); pen.globalAlpha = 1;
    pen.strokeStyle = theme.wall; pen.lineWidth = 1.5; pen.stroke();
  }
  pen.strokeStyle = theme.wall;
  pen.lineWidth = 2.5;
  pen.beginPath();
  for (const [x1, y1, x2, y2] of world.walls) {
    pen.moveTo(...toScreen(view, x1, y1)); pen.lineTo(...toScreen(view, x2, y2));
  }
  pen.stroke();
  pen.fillStyle = theme.wall;
  pen.font = '12px system-ui, sans-serif';
  innerWalls(world).forEach(([[x1, y1], [x2, y2]], k) => {
    const name = world.wall_names?.[k], [px, py] = toScreen(view, (x1 + x2) / 2, (y1 + y2) / 2);
    if (name) pen.fillText(name, px + 6, py - 6);
  });
}

// An open door is dashed.
function drawDoors(pen, world, view, { theme }) {
  pen.font = '12px system-ui, sans-serif';
  for (const { name, ends: [start, end], open } of world.doors ?? []) {
    pen.strokeStyle = pen.fillStyle = theme.encoder;
    pen.lineWidth = open ? 1.5 : 4;
    pen.setLineDash(open ? [5, 4] : []);
    line(pen, view, ...start, ...end);
    const [px, py] = toScreen(view, (start[0] + end[0]) / 2, (start[1] + end[1]) / 2);
    pen.fillText(name, px + 6, py - 6);
  }
  pen.setLineDash([]);
}

// Routes are dotted.
function drawWalkers(pen, scene, view, { theme }) {
  for (const [k, { points, radius, closed }] of (scene.world.walkers ?? []).entries()) {
    pen.strokeStyle = theme.quiet;
    pen.lineWidth = 1;
    pen.setLineDash([2, 4]);
    pen.beginPath();
    points.forEach(([x, y], number) => (number ? pen.lineTo : pen.moveTo).call(pen, ...toScreen(view, x, y)));
    if (closed) pen.closePath();
    pen.stroke();
    pen.setLineDash([]);
    circle(pen, view, ...(scene.walkers[k] ?? points[0]), radius);
    pen.fillStyle = theme.obstacle;
    pen.fill();
    pen.strokeStyle = theme.wall;
    pen.lineWidth = 1.5;
    pen.stroke();
  }
}

function drawTraces(pen, traces, view, theme) {
  if (!traces) return;
  for (const [name, colour] of [['encoder', theme['encoder-trace']], ['actual', theme['actual-trace']]]) {
    const points = traces[name].points;
    pen.strokeStyle = colour;
    pen.lineWidth = 1.5;
    pen.beginPath();
    // null, null marks a gap: the robot was placed elsewhere
    for (let k = 0, pass = pen.moveTo; k + 1 < points.length; k += 2) {
      if (points[k] === null) { pass = pen.moveTo; continue; }
      pass.call(pen, ...toScreen(view, points[k], points[k + 1]));
      pass = pen.lineTo;
    }
    pen.stroke();
  }
}

// Sonar beams start where each sonar emitted its ping and laser points are where they were measured; infrared readings are
// drawn at the current pose.
function drawSensors(pen, scene, id, view, { theme, shown }) {
  const robot = scene.robots[id], body = scene.bodies[id], laser = scene.lasers[id];
  const [x, y] = robot.actual;
  if (shown.sonar) {
    const readings = sonarReadings(robot, body), walls = wallsWithin(scene.world, x, y, body.ring_in + body.sonars.max_in + BEAM_MARGIN_IN);
    for (const [k, ...from] of scene.beams[id] ?? []) drawBeam(pen, view, from, body, readings[k], theme.sonar, walls);
  }
  if (shown.infrared && body.sees) {
    pen.strokeStyle = theme.infrared; pen.lineWidth = 4;
    robot.state.slice(1, 17).forEach((near, k) => {
      const direction = robot.actual[3] + infraredAngle(k);
      if (near < NO_INFRARED) ray(pen, view, x, y, direction, body.radius_in, body.radius_in + near);
    });
  }
  if (!shown.laser || !laser) return;
  pen.fillStyle = theme.laser;
  for (let k = 0; k + 1 < laser.length; k += 2) {
    const [px, py] = toScreen(view, laser[k], laser[k + 1]);
    pen.fillRect(px - 1, py - 1, 2, 2);
  }
}

// Without an echo a beam is drawn as far as the sonar measures. Its cone ends at walls.
function drawBeam(pen, view, [x, y, direction], { ring_in: ring, sonars }, reading, colour, walls) {
  const nothing = !isEcho(reading, sonars), far = ring + shownRange(reading, sonars), cone = sonars.half_cone;
  const [px, py] = toScreen(view, x, y);
  pen.globalAlpha = nothing ? 0.03 : 0.09;
  pen.fillStyle = colour;
  pen.beginPath();
  pen.moveTo(px, py);
  const angles = Array.from({ length: CONE_RAYS + 1 }, (_, k) => direction + cone * (2 * k / CONE_RAYS - 1));
  wallDistances(walls, x, y, angles, far).forEach((reach, k) => {
    pen.lineTo(...toScreen(view, x + reach * Math.cos(angles[k]), y + reach * Math.sin(angles[k])));
  });
  pen.closePath();
  pen.fill();
  pen.globalAlpha = nothing ? 0.25 : 0.9;
  pen.strokeStyle = colour;
  pen.lineWidth = 1;
  ray(pen, view, x, y, direction, ring, far);
  pen.globalAlpha = 1;
}

function ray(pen, view, x, y, direction, from, to) {
  const c = Math.cos(direction), s = Math.sin(direction);
  line(pen, view, x + from * c, y + from * s, x + to * c, y + to * s);
}

export function drawRobot(pen, [x, y, steer, turret], body, view, { colour, dashed, chosen }) {
  pen.strokeStyle = colour;
  pen.fillStyle = colour;
  pen.lineWidth = 2;
  pen.setLineDash(dashed ? [5, 4] : []);
  circle(pen, view, x, y, body.radius_in);
  if (!dashed) { pen.globalAlpha = chosen ? 0.4 : 0.18; pen.fill(); pen.globalAlpha = 1; }
  pen.stroke();
  pen.setLineDash([]);
  arrow(pen, view, x, y, steer, body.radius_in);
  if (!body.differential) {
    circle(pen, view, x, y, body.radius_in * 0.55);
    pen.lineWidth = 1;
    pen.stroke();
    ray(pen, view, x, y, turret, body.radius_in * 0.55, body.radius_in);
  }
}

// Number and name of each robot, where neither another label nor a robot is: beside the robot, the name left out where only
// the number fits, and otherwise the number inside of the robot, in letters small enough for it.
function drawLabels(pen, scene, view, { theme, names }) {
  const robots = Object.entries(scene.robots).filter(([id]) => scene.bodies[id]);
  const circles = robots.map(([id, { actual }]) => ({ id, at: toScreen(view, actual[0], actual[1]), radius: scene.bodies[id].radius_in * view.scale }));
  pen.fillStyle = theme.actual;
  for (const { text, x, y, size } of placeLabels(circles, names ?? {}, view.width)) {
    pen.font = `${size}px system-ui, sans-serif`;
    pen.fillText(text, x, y);
  }
}

// Return [{text, x, y, size, box}]: x and y are the left end of the base line, box is [left, top, right, bottom], in pixels.
// Labels of robots at the edge of the map, `width` pixels wide, stay on it.
export function placeLabels(circles, names, width) {
  const placed = [], bodies = circles.map(({ id, at: [x, y], radius }) => ({ id, box: [x - radius, y - radius, x + radius, y + radius] }));
  for (const { id, at: [x, y], radius } of circles) {
    const texts = names[id] ? [`${id} ${names[id]}`, id] : [id];
    const others = [...bodies.filter((body) => body.id !== id), ...placed];
    const fits = texts.flatMap((text) => labelPlaces(text, x, y, radius))
      .find(({ box }) => box[0] >= 0 && box[2] <= width && !others.some((other) => overlap(box, other.box)));
    placed.push(fits ?? labelInside(id, x, y, radius));
  }
  return placed;
}

const LABEL_PX = 12, LETTER = 0.62, LABEL_GAP_PX = 2;  // size, width of a letter by size, distance to the robot

function labelAt(text, left, top, size) {
  const width = text.length * LETTER * size;
  return { text, size, x: left, y: top + size * 0.85, box: [left, top, left + width, top + size] };
}

// Right above first, as on maps; then the other corners and sides.
function labelPlaces(text, x, y, radius) {
  const width = text.length * LETTER * LABEL_PX, near = radius * 0.75 + LABEL_GAP_PX, far = radius + LABEL_GAP_PX;
  return [[x + near, y - near - LABEL_PX], [x - near - width, y - near - LABEL_PX], [x + near, y + near], [x - near - width, y + near],
    [x - width / 2, y - far - LABEL_PX], [x - width / 2, y + far], [x + far, y - LABEL_PX / 2], [x - far - width, y - LABEL_PX / 2]]
    .map(([left, top]) => labelAt(text, left, top, LABEL_PX));
}

function labelInside(text, x, y, radius) {
  const size = Math.min(LABEL_PX, 1.6 * radius / Math.hypot(1, text.length * LETTER));
  return labelAt(text, x - text.length * LETTER * size / 2, y - size / 2, size);
}

function overlap([left, top, right, bottom], [l, t, r, b]) { return left < r && l < right && top < b && t < bottom; }

export function arrow(pen, view, x, y, direction, length_in) {
  const [px, py] = toScreen(view, x + length_in * Math.cos(direction), y + length_in * Math.sin(direction));
  line(pen, view, x, y, x + length_in * Math.cos(direction), y + length_in * Math.sin(direction));
  const size = Math.max(6, length_in * view.scale * 0.25);
  pen.beginPath();
  pen.moveTo(px, py);
  for (const turn of [2.6, -2.6]) pen.lineTo(px + size * Math.cos(direction + turn), py - size * Math.sin(direction + turn));
  pen.closePath();
  pen.fill();
}

function drawBumpers(pen, robot, body, view, theme) {
  const [x, y] = robot.actual, [px, py] = toScreen(view, x, y), half = Math.PI / body.bumpers;
  pen.strokeStyle = theme.hit;
  pen.lineWidth = 5;
  for (let k = 0; k < body.bumpers; k += 1) {
    if (!(robot.state[33] >> k & 1)) continue;
    const middle = robot.front + k * 2 * half;
    pen.beginPath();
    pen.arc(px, py, body.radius_in * view.scale, -middle - half, -middle + half);
    pen.stroke();
  }
}

function drawScale(pen, view, { theme, metric }) {
  const length = roundLength(view.scale, 60, unitIn(metric)), wide = length * view.scale, y = view.height - 14;
  pen.strokeStyle = theme.ink;
  pen.fillStyle = theme.ink;
  pen.lineWidth = 2;
  pen.beginPath();
  pen.moveTo(12, y - 4); pen.lineTo(12, y); pen.lineTo(12 + wide, y); pen.lineTo(12 + wide, y - 4);
  pen.stroke();
  pen.font = '12px system-ui, sans-serif';
  pen.fillText(lengthText(length, metric, length < unitIn(metric) ? 2 : 0), 16, y - 5);
}

// Draw the client graphics on a canvas of their own, where shapes in XOR mode cancel each other, as on old displays.
export function drawGraphics(pen, scene, view, { theme }) {
  for (const shape of scene.graphics) {
    pen.globalCompositeOperation = shape[4] ? 'xor' : 'source-over';
    drawShape(pen, shape, view, clientColour(shape[3], theme));
  }
  pen.globalCompositeOperation = 'source-over';
}

// Draw a shape [number, figure, coordinates in tenths, colour, is in XOR mode].
export function drawShape(pen, [, figure, tenths], view, colour) {
  const n = tenths.map((tenth) => tenth / 10);
  pen.strokeStyle = pen.fillStyle = colour;
  pen.lineWidth = 2;
  const radians = (degrees) => degrees * Math.PI / 180;
  if (figure === 'line') line(pen, view, n[0], n[1], n[2], n[3]);
  else if (figure === 'arc') drawArc(pen, n, view);
  else if (figure === 'arrow') arrow(pen, view, n[0], n[1], radians(n[2]), 12);
  else {
    pen.beginPath();
    const [px, py] = toScreen(view, n[0], n[1]), r = 9 * view.scale;
    pen.arc(px, py, r, 0, 2 * Math.PI);
    for (const [angle, length] of [[radians(n[2]), r], [radians(n[3]), r * 0.6]]) {
      pen.moveTo(px, py);
      pen.lineTo(px + length * Math.cos(angle), py - length * Math.sin(angle));
    }
    pen.stroke();
  }
}

// Draw an arc as X does: upper left corner, width and height of its box, start angle and extent in degrees.
function drawArc(pen, [x, y, w, h, from, extent], view) {
  const [px, py] = toScreen(view, x + w / 2, y - h / 2), radians = (degrees) => degrees * Math.PI / 180;
  pen.beginPath();
  pen.ellipse(px, py, Math.abs(w / 2) * view.scale, Math.abs(h / 2) * view.scale, 0,
    -radians(from), -radians(from + extent), extent > 0);
  pen.stroke();
}
