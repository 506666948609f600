// The window Learned map and that map on the map, of the selected robot: walls and points that `nomad map learn --publish` has
// found so far, uncertain walls dashed, and the robot where that program takes it to be. It becomes faint when the drive is over.

import { toScreen } from './geometry.js';
import { circle, arrow } from './draw.js';
import { linkWith } from './menus.js';
import { cell, element, table } from './widgets.js';
import { lengthText, degreesText } from './units.js';

const STALE_S = 10, MAX_AGE_S = 600, POINT_PX = 3, DASHES = [7, 5];

export const learnedMapWindow = {
  id: 'learned-map', title: 'Learned map', of: {},
  build(box) {
    this.state = element('p', { id: 'learning', role: 'status' });
    box.append(this.state);
    this.rows = table(box, 'Learned map');
  },
  reset() { this.of = {}; },
  onMessage(message, app) {
    if (message.type !== 'map') return;
    this.of[message.robot] = { ...message, received_ms: performance.now() - 1000 * (message.age_s ?? 0) };
    app.map.requestRedraw();
    app.requestUpdate();
  },
  // Return the map of a robot; null without one and when it is outdated.
  currentMap(id) {
    const map = this.of[id];
    return map && ageOf(map) < MAX_AGE_S ? map : null;
  },
  update(app) {
    const map = this.currentMap(app.robot);
    const text = map ? stateOf(map) : hint(app);
    if (this.state.textContent !== text) { this.state.textContent = text; app.map.requestRedraw(); }
    const uncertain = map?.walls.filter((wall) => wall.is_uncertain).length;
    cell(this.rows, 'walls', map && `${map.walls.length}, ${uncertain} of them uncertain (dashed)`);
    cell(this.rows, 'points', map && `${map.points.length} corners, ends of walls, and posts`);
    cell(this.rows, 'robot', map && `${map.pose.slice(0, 2).map((inches) => lengthText(inches, app.metric, 1)).join(', ')}, ${degreesText(map.pose[2])}`);
    cell(this.rows, 'driven', map && `${map.elapsed_s.toFixed(0)} s`);
  },
  draw(pen, scene, view, { theme, robot }) {
    const map = this.currentMap(robot), body = scene.bodies[robot];
    if (!map) return;
    pen.globalAlpha = isOver(map) ? 0.5 : 1;
    pen.strokeStyle = pen.fillStyle = theme.estimate;
    for (const { ends, is_uncertain: isUncertain } of map.walls) {
      pen.lineWidth = isUncertain ? 2 : 3;
      pen.setLineDash(isUncertain ? DASHES : []);
      pen.beginPath();
      pen.moveTo(...toScreen(view, ...ends[0]));
      pen.lineTo(...toScreen(view, ...ends[1]));
      pen.stroke();
    }
    pen.setLineDash([]);
    for (const [x, y] of map.points) { circle(pen, view, x, y, POINT_PX / view.scale); pen.fill(); }
    if (body && !isOver(map)) {
      pen.lineWidth = 1.5;
      circle(pen, view, map.pose[0], map.pose[1], body.radius_in);
      pen.stroke();
      arrow(pen, view, ...map.pose, body.ring_in);
    }
    pen.globalAlpha = 1;
  },
};

function ageOf(map) { return window.nserverRun ? 0 : (performance.now() - map.received_ms) / 1000; }

function isOver(map) { return Boolean(map.outcome) || ageOf(map) > STALE_S; }

function stateOf(map) {
  if (map.outcome) return map.outcome;
  return isOver(map) ? `No message for ${Math.round(ageOf(map))} s: this map is old.` : 'The map grows.';
}

// Return how to learn a map; read-only pages must not show the token.
function hint(app) {
  const none = `No program learns a map with robot ${app.robot}.`;
  if (!app.mayAct || window.nserverRun) return none;
  const address = app.lines.nserver ?? 'localhost:7019';
  return `${none} In a terminal: nomad map learn nserver://${address}/${app.robot} --out room.toml --publish '${linkWith(location, app.token)}'`;
}
