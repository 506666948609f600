// The window with walls, obstacles, doors, walkers and world files: by corners and by keyboard, the gallery, undo, saving and loading. Hidden on read-only pages. The
// server reads and writes the world format; the page only transfers the text.

import { element, button, download, form, lengthField } from './widgets.js';
import { addObstacle, callRobot, control, poseTenths } from './commands.js';
import { robotFits } from './geometry.js';
import { listThings, WALKING_SPEED } from './things.js';
import { lengthText, unitIn, unitName } from './units.js';

const STEP_IN = 1, EXAMPLE = '10,10 20,10 20,20';

// Parse corners: pairs x,y separated by blanks. Return null for any other text.
export function parseCorners(text) {
  const pairs = text.trim().split(/\s+/).map((pair) => pair.split(','));
  const isValid = pairs.every((pair) => pair.length === 2 && pair.every((part) => part.trim() && Number.isFinite(Number(part))));
  return isValid ? pairs.map((pair) => pair.map(Number)) : null;
}

export const worldWindow = {
  id: 'world', title: 'Walls, obstacles, people, world files', moves: Promise.resolve(), rows: [],
  build(box, app) {
    this.list = element('div', { id: 'world-list' });
    const corners = element('input', { id: 'corners', placeholder: EXAMPLE, size: 22 }), name = document.createTextNode('');
    const label = element('label', {}, name, corners);
    const relabel = () => { name.data = `corners, ${unitName(app.metric)}`; this.shown = null; };
    app.onUnits(relabel);
    relabel();
    this.step = lengthField(app, 'move by', STEP_IN, { min: 0.1, id: 'move-step' });
    this.speed = lengthField(app, 'walkers', WALKING_SPEED, { min: 1, id: 'walking-speed', onchange: () => { app.walkingSpeed = this.speed.inches; } }, '/s');
    this.undo = button('Undo', () => app.history.undo(), { id: 'undo' });
    this.redo = button('Redo', () => app.history.redo(), { id: 'redo' });
    const file = element('input', { type: 'file', accept: '.toml', id: 'load-world', hidden: true, onchange: async () => {
      const [chosen] = file.files;
      if (chosen) await loadWorld(app, await chosen.text(), chosen.name);
      file.value = '';
    } });
    box.append(gallery(app),
      form(() => {
        const typed = parseCorners(corners.value);
        if (!typed) app.notice(`Corners must be pairs x,y, for example ${EXAMPLE}`);
        else addObstacle(app, typed.map((corner) => corner.map((number) => number * unitIn(app.metric))));
      }, element('div', { className: 'row' }, label, element('button', { id: 'add-corners' }, 'Add'), this.step.label, this.speed.label)),
      element('div', { className: 'row halves' }, this.undo, this.redo),
      tapeForm(app), labelForm(app),
      element('div', { className: 'row' }, button('Save world', () => saveWorld(app), { id: 'save-world' }), file,
        button('Load world', () => file.click()), button('Remove all obstacles', () => clearWorld(app), { id: 'clear-world' })),
      this.list);
  },
  update(app) {
    for (const [button_, title, word, keys] of [[this.undo, app.history.undoTitle, 'Undo', 'Ctrl+Z'], [this.redo, app.history.redoTitle, 'Redo', 'Ctrl+Shift+Z']]) {
      button_.disabled = title === null;
      button_.textContent = title === null ? word : `${word}: ${title}`;
      button_.title = title === null ? keys : `${word}: ${title} (${keys})`;
    }
    if (this.shown === app.scene.world) return;
    // Lengths are those of one map.
    if (this.shown && this.shown.name !== app.scene.world?.name) app.setTapes([]);
    this.shown = app.scene.world;
    const things = listThings(app);
    while (this.rows.length < things.length) this.rows.push(this.newRow(app));
    for (const row of this.rows.splice(things.length)) row.node.remove();
    this.rows.forEach((row, k) => row.show(things[k]));
  },
  // A row with the points of a thing and buttons that move it in steps and delete it. A row stays when the world changes,
  // so that no press of a button is lost; the row then shows another thing. A press is for the newest one shown.
  newRow(app) {
    const text = element('span'), row = { node: element('div', { className: 'row' }, text), pressed: null };
    const action = (sign, word, act) => {
      const pick = () => { this.update(app); row.pressed = row.thing; };
      const node = button(sign, () => { if (!row.pressed) pick(); act(row.pressed); row.pressed = null; }, { title: word,
        // Released above another row, the press still counts.
        onpointerdown: (event) => { pick(); node.setPointerCapture(event.pointerId); } });
      node.dataset.word = word;
      return node;
    };
    const by = (dx, dy) => (thing) => { this.moves = this.moves.then(() => shift(thing, dx * this.step.inches, dy * this.step.inches)); };
    row.node.append(action('←', 'move left', by(-1, 0)), action('→', 'move right', by(1, 0)), action('↑', 'move up', by(0, 1)),
      action('↓', 'move down', by(0, -1)), action('Delete', 'delete', (thing) => thing.remove(thing.points)), action('Open', 'open', (thing) => thing.toggle()));
    row.show = (thing) => {
      const round = (inches) => String(Math.round(inches / unitIn(app.metric) * 10) / 10);
      row.thing = thing;
      text.textContent = `${thing.name}: ${thing.points.map((corner) => corner.map(round).join(',')).join(' ')}`;
      row.node.lastChild.hidden = !thing.toggle;
      row.node.lastChild.textContent = thing.isOpen ? 'Close' : 'Open';
      row.node.lastChild.dataset.word = row.node.lastChild.title = thing.isOpen ? 'close' : 'open';
      for (const node of row.node.querySelectorAll('button')) node.ariaLabel = `${node.dataset.word} ${thing.name}`;
    };
    this.list.append(row.node);
    return row;
  },
};

// Move a thing. Its new corners are stored at once: the next move may come before the next picture.
async function shift(thing, dx_in, dy_in) {
  const answer = await thing.move(thing.points, dx_in, dy_in);
  if (answer.ok) thing.points = answer.result.is;
}

async function worldText(app) {
  const answer = await control(app, 'world show');
  return answer.ok ? answer.result.text : null;
}

async function saveWorld(app) {
  const text = await worldText(app);
  if (text !== null) download(`${app.scene.world.name}.toml`, 'text/plain', text);
}

// Replace the world. Undo restores the whole previous world, and the robots that had no room in the new one to their poses,
// unless the new one was changed meanwhile: those changes would be lost.
function replaceWorld(app, title, apply, options = {}, onDone = () => {}) {
  let before = null, after = null, poses = [];
  return app.history.run({ title, apply: async () => {
    before = await worldText(app);
    poses = Object.entries(app.scene.robots).map(([id, { actual }]) => [id, [...actual]]);
    if (before === null) return { ok: false, error: 'the world cannot be read' };
    const answer = await apply();
    if (answer.ok) { after = await worldText(app); onDone(true, after); }
    return answer;
  }, revert: async () => {
    if (await worldText(app) !== after) return { ok: false, error: 'the world was changed meanwhile' };
    const placed = poses.filter(([id, pose]) => app.scene.robots[id] && !robotFits(app.scene, id, pose));
    const answer = await control(app, 'world set', { text: before, file: 'the world before', ...options });
    for (const [id, pose] of answer.ok ? placed : []) await callRobot(app, 'place_robot', poseTenths(pose), Number(id));
    if (answer.ok) onDone(false);
    return answer;
  } });
}

// Lengths measured with a tape: the tool chooses the ends, the form takes the length. The map before the first length adjusts
// to all of them, so that each counts once. A change by another tool ends this: then the changed map adjusts to later lengths.
function tapeForm(app) {
  const tape = lengthField(app, 'length', 0, { min: 0, id: 'tape-length' }), list = element('ul', { id: 'tapes' });
  const text = (ends) => ends.map((end) => end.map((inches) => Math.round(inches / unitIn(app.metric) * 10) / 10).join(',')).join(' to ');
  app.setTapes = (tapes) => {
    app.tapes = tapes;
    list.replaceChildren(...tapes.map(({ ends, length }) => element('li', {}, `${text(ends)}: ${lengthText(length, app.metric, 2)}`)));
  };
  const node = form(async () => {
    const before = { tapes: app.tapes, base: node.base }, now = await worldText(app), { name } = app.scene.world;
    if (now === null) return;
    const goesOn = node.base?.after === now, origin = goesOn ? node.base.origin : now;
    const tapes = [...(goesOn ? app.tapes : []), { ends: node.ends, length: tape.inches }];
    const answer = await replaceWorld(app, 'adjust to a length', async () => {
      const adjusted = await app.link.request({ do: 'adjust', lengths: tapes, text: origin });
      return adjusted.ok ? control(app, 'world set', { text: adjusted.text, file: `${name}.toml` }) : adjusted;
    }, {}, (isDone, after) => {
      app.setTapes(isDone ? tapes : before.tapes);
      node.base = isDone ? { origin, after } : before.base;
    });
    app.notice(answer.ok ? '' : answer.error);
    if (answer.ok) node.hidden = true;
  }, element('p'), element('div', { className: 'row' }, tape.label, element('button', { id: 'adjust' }, 'Adjust walls'),
    button('Cancel', () => { node.hidden = true; })));
  node.hidden = true;
  app.setTapes([]);
  app.measure = (ends) => {
    node.ends = ends;
    node.firstChild.textContent = `Measured from ${text(ends)}:`;
    tape.inches = Math.hypot(ends[1][0] - ends[0][0], ends[1][1] - ends[0][1]);
    node.hidden = false;
    tape.input.focus();
    tape.input.select();
  };
  return element('div', {}, node, list);
}

// The name of an inner wall, which the tool Label chooses.
function labelForm(app) {
  const name = element('input', { id: 'wall-name', maxLength: 60, size: 22 });
  let wall = null;
  const node = form(async () => {
    const answer = await wall.rename(wall.points, name.value.trim());
    if (answer.ok) node.hidden = true;
  }, element('div', { className: 'row' }, element('label', {}, 'name of the wall', name), element('button', { id: 'label-wall' }, 'Label'),
    button('Cancel', () => { node.hidden = true; })));
  node.hidden = true;
  app.label = (chosen) => {
    wall = chosen;
    name.value = wall.name.match(/^wall \d+$/) ? '' : wall.name;
    node.hidden = false;
    name.focus();
    name.select();
  };
  return node;
}

export function loadWorld(app, text, file) {
  return replaceWorld(app, `load ${file}`, () => control(app, 'world set', { text, file }));
}

// The shipped worlds with pictures. Robots that have no room in the chosen one are placed at its starts.
function gallery(app) {
  const list = element('div', { className: 'gallery' });
  const fill = async () => {
    if (list.firstChild) return;
    const answer = await app.link.request({ do: 'gallery' });
    if (answer.ok) list.replaceChildren(...answer.worlds.map((world) => galleryButton(app, world)));
    else app.notice(answer.error);
  };
  return element('details', { id: 'gallery', ontoggle: (event) => { if (event.target.open) fill(); } }, element('summary', {}, 'Choose a world'), list);
}

function galleryButton(app, { name, title, text, walls }) {
  const places = { places: true }, choose = () => replaceWorld(app, `world ${name}`, async () => {
    const answer = await control(app, 'world set', { text, file: `${name}.toml`, ...places });
    if (answer.ok) app.restartLocalizer();
    return answer;
  }, places);
  return element('button', { type: 'button', id: `world-${name}`, title, onclick: choose }, picture(walls), element('span', {}, name.replaceAll('_', ' ')));
}

// Return a small drawing of walls.
function picture(walls) {
  const xs = walls.flatMap(([x1, , x2]) => [x1, x2]), ys = walls.flatMap(([, y1, , y2]) => [y1, y2]);
  const [left, top] = [Math.min(...xs), Math.min(...ys)], wide = Math.max(...xs) - left, high = Math.max(...ys) - top;
  const svg = document.createElementNS('http://www.w3.org/2000/svg', 'svg'), lines = document.createElementNS(svg.namespaceURI, 'path');
  // y points up in the world and down in the drawing.
  lines.setAttribute('d', walls.map(([x1, y1, x2, y2]) => `M${x1} ${-y1}L${x2} ${-y2}`).join(''));
  lines.setAttribute('vector-effect', 'non-scaling-stroke');
  svg.setAttribute('viewBox', `${left - 2} ${-top - high - 2} ${wide + 4} ${high + 4}`);
  svg.setAttribute('aria-hidden', 'true');
  svg.append(lines);
  return svg;
}

function clearWorld(app) {
  return replaceWorld(app, 'remove all', () => callRobot(app, 'new_world', []));
}
