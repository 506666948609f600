// The window World: obstacles by their corners and by keyboard, undo, the whole world saved and loaded. Shown to who may
// act. Rules: the daemon reads and writes world files, the page only carries them.

import { element, button, download, form, lengthField } from './parts.js';
import { addObstacle, deleteObstacle, moveObstacle } from './tools.js';
import { control } from './control.js';
import { unitIn, unitName } from './units.js';

const STEP_IN = 1, EXAMPLE = '10,10 20,10 20,20';

// Corners as typed: x,y pairs with blanks between them; null for anything else.
export function typedCorners(text) {
  const pairs = text.trim().split(/\s+/).map((pair) => pair.split(','));
  const right = pairs.every((pair) => pair.length === 2 && pair.every((part) => part.trim() && Number.isFinite(Number(part))));
  return right ? pairs.map((pair) => pair.map(Number)) : null;
}

export const worldWindow = {
  id: 'world', title: 'World', acts: true, moves: Promise.resolve(),
  build(box, app) {
    this.list = element('div', { id: 'world-list' });
    const corners = element('input', { id: 'corners', placeholder: EXAMPLE, size: 22 }), name = document.createTextNode('');
    const label = element('label', {}, name, corners);
    const relabel = () => { name.data = `corners, ${unitName(app.metric)}`; this.shown = null; };
    app.onUnits(relabel);
    relabel();
    this.step = lengthField(app, 'move by', STEP_IN, { min: 0.1, id: 'move-step' });
    this.undo = button('Undo', () => app.undo.undo(), { id: 'undo' });
    this.redo = button('Redo', () => app.undo.redo(), { id: 'redo' });
    const file = element('input', { type: 'file', accept: '.toml', id: 'load-world', hidden: true, onchange: async () => {
      const [chosen] = file.files;
      if (chosen) await loadWorld(app, await chosen.text(), chosen.name);
      file.value = '';
    } });
    box.append(
      form(() => {
        const typed = typedCorners(corners.value);
        if (!typed) app.notice(`corners are such as ${EXAMPLE}`);
        else addObstacle(app, typed.map((corner) => corner.map((number) => number * unitIn(app.metric))));
      }, element('div', { className: 'row' }, label, element('button', { id: 'add-corners' }, 'Add'), this.step.label)),
      element('div', { className: 'row halves' }, this.undo, this.redo),
      element('div', { className: 'row' }, button('Save world', () => saveWorld(app), { id: 'save-world' }), file,
        button('Load world', () => file.click()), button('Remove all obstacles', () => clearWorld(app), { id: 'clear-world' })),
      this.list);
  },
  update(app) {
    for (const [pressed, title, word, keys] of [[this.undo, app.undo.next, 'Undo', 'Ctrl+Z'], [this.redo, app.undo.again, 'Redo', 'Ctrl+Shift+Z']]) {
      pressed.disabled = title === null;
      pressed.textContent = title === null ? word : `${word}: ${title}`;
      pressed.title = title === null ? keys : `${word}: ${title} (${keys})`;
    }
    if (this.shown === app.scene.world) return;
    this.shown = app.scene.world;
    const focused = document.activeElement?.dataset?.key;
    this.list.replaceChildren(...(this.shown?.obstacles ?? []).map((thing, k) => this.row(app, thing, k)));
    if (focused) this.list.querySelector(`[data-key="${focused}"]`)?.focus();
  },
  row(app, thing, k) {
    const name = thing.name || `obstacle ${k + 1}`, round = (inches) => String(Math.round(inches / unitIn(app.metric) * 10) / 10);
    const press = (sign, word, act) => {
      const made = button(sign, act, { title: word, ariaLabel: `${word} ${name}` });
      made.dataset.key = `${k} ${word}`;
      return made;
    };
    const by = (dx, dy) => () => { this.moves = this.moves.then(() => shift(app, k, dx * this.step.inches, dy * this.step.inches)); };
    return element('div', { className: 'row' },
      element('span', {}, `${name}: ${thing.corners.map((corner) => corner.map(round).join(',')).join(' ')}`),
      press('←', 'move left', by(-1, 0)), press('→', 'move right', by(1, 0)), press('↑', 'move up', by(0, 1)), press('↓', 'move down', by(0, -1)),
      press('Delete', 'delete', () => deleteObstacle(app, thing)));
  },
};

// Moves the obstacle of that number, from where the move before it left it, though no picture of that came yet.
async function shift(app, k, dx_in, dy_in) {
  const thing = app.scene.world.obstacles[k];
  if (!thing) return;
  const answer = await moveObstacle(app, thing.corners, dx_in, dy_in);
  if (answer.ok) thing.corners = answer.said.is;
}

async function worldNow(app) {
  const answer = await control(app, 'world show');
  return answer.ok ? answer.said.text : null;
}

async function saveWorld(app) {
  const text = await worldNow(app);
  if (text !== null) download(`${app.scene.world.name}.toml`, 'text/plain', text);
}

// Puts another world in place of this one. One step of undo brings that back, whole, unless somebody changed the new one
// meanwhile, for that would be lost.
function replaceWorld(app, title, forth) {
  let before = null, after = null;
  return app.undo.run({ title, forth: async () => {
    before = await worldNow(app);
    if (before === null) return { ok: false, error: 'the world cannot be read' };
    const answer = await forth();
    if (answer.ok) after = await worldNow(app);
    return answer;
  }, back: async () => (await worldNow(app) === after
    ? control(app, 'world set', { text: before, file: 'the world before' })
    : { ok: false, error: 'the world has been changed since, by somebody else' }) });
}

export function loadWorld(app, text, file) {
  return replaceWorld(app, `load ${file}`, () => control(app, 'world set', { text, file }));
}

function clearWorld(app) {
  return replaceWorld(app, 'remove all', async () => {
    const answer = await app.link.ask({ do: 'call', robot: Number(app.robot), call: 'new_world', args: [] });
    app.notice(answer.ok ? '' : answer.error);
    return answer;
  });
}
