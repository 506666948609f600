// The window Robots: all robots with their names, health and programs; a click selects one. A page that may act on all of
// them, such as a teacher's, stops, releases and resets them here. Hidden while there is one robot.

import { element, button } from './widgets.js';

export const robotsWindow = {
  id: 'robots', title: 'Robots',
  build(box, app) {
    this.rows = new Map();
    this.programs = {};
    this.body = element('tbody');
    const heads = ['Robot', 'Health', 'Program'].map((text) => element('th', { scope: 'col' }, text));
    const table = element('table', { className: 'robots', ariaLabel: 'Robots' },
      element('thead', {}, element('tr', {}, ...heads, element('td', { className: 'acts' }))), this.body);
    this.buttons = element('div', { className: 'row acts live all-robots' },
      button('Stop all', () => app.stop(), { className: 'stop', id: 'robots-stop' }),
      button('Release all', () => send(app, { do: 'release' }), { id: 'robots-release' }),
      button('Reset all', () => send(app, { do: 'reset' }), { id: 'robots-reset', title: 'Return all robots to where they started' }));
    box.append(this.buttons, element('div', { className: 'scrolls', tabIndex: 0, role: 'region', ariaLabel: 'List of robots' }, table));
  },
  onMessage(message) { if (message.type === 'programs') this.programs = message.robots; },
  reset() { this.programs = {}; },
  update(app) {
    const ids = Object.keys(app.scene.robots);
    this.box.parentElement.hidden = ids.length < 2;
    if (ids.length < 2) return;
    for (const [id, row] of this.rows) if (!ids.includes(id)) { row.node.remove(); this.rows.delete(id); }
    for (const id of ids) {
      if (!this.rows.has(id)) this.rows.set(id, newRow(app, id, this.body));
      showRow(this.rows.get(id), app, id, this.programs[id] ?? []);
    }
  },
};

async function send(app, message) {
  const answer = await app.link.request(message);
  app.notice(answer.ok ? '' : answer.error);
}

function newRow(app, id, body) {
  const number = Number(id), name = button('', () => app.selectRobot(id), { className: 'name' });
  const light = element('i', { className: 'light' }), health = element('span'), program = element('td');
  const hold = button('Stop', () => (app.scene.robots[id].held ? send(app, { do: 'release', robot: number }) : app.stop(number)));
  const back = button('Reset', () => send(app, { do: 'reset', robot: number }));
  const buttons = element('td', { className: 'acts live' }, hold, ' ', back);
  const node = element('tr', {}, element('th', { scope: 'row' }, name), element('td', {}, light, health), program, buttons);
  body.append(node);
  return { node, name, light, health, program, hold, back, buttons };
}

function showRow(row, app, id, programs) {
  const robot = app.scene.robots[id], label = robotLabel(id, app.names), state = healthOf(robot, app.estimateOf(id));
  const set = (node, text) => { if (node.textContent !== text) node.textContent = text; };
  set(row.name, label);
  row.name.setAttribute('aria-pressed', String(id === app.robot));
  row.light.className = `light ${state.grade}`;
  set(row.health, state.text);
  set(row.program, programText(programs));
  row.program.classList.toggle('several', programs.length > 1);
  set(row.hold, robot.held ? 'Release' : 'Stop');
  row.hold.ariaLabel = `${row.hold.textContent} ${label}`;
  row.back.ariaLabel = `Reset ${label}`;
  row.buttons.classList.toggle('not-own', app.ownRobot !== null && app.ownRobot !== id);
}

export function robotLabel(id, names) { return names[id] ? `${id} ${names[id]}` : id; }

// Return how a robot is: the most urgent of hold, contact and health of its estimate, else whether it moves.
export function healthOf(robot, estimate) {
  if (robot.held) return { grade: 'bad', text: `stopped by ${robot.held.by}${robot.held.ignored ? `, ${robot.held.ignored} commands refused` : ''}` };
  if (robot.state[33]) return { grade: 'bad', text: 'touches something' };
  if (estimate?.trust === 'LOST') return { grade: 'bad', text: 'lost' };
  if (estimate?.trust === 'DEGRADED') return { grade: 'warn', text: 'uncertain where it is' };
  return { grade: 'good', text: robot.state[41] & 7 ? 'moves' : 'stands' };
}

// Programs by their addresses; more than one is usually a wrong robot number.
export function programText(programs) {
  if (!programs.length) return 'none';
  return programs.length > 1 ? `${programs.length}: ${programs.join(', ')}` : programs[0];
}
