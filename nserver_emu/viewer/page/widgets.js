// Building blocks of the windows: tables, canvases at screen resolution, labelled buttons and fields.

import { unitIn, unitName } from './units.js';

export function element(tag, attributes = {}, ...children) {
  const node = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (name.startsWith('on')) node.addEventListener(name.slice(2), value);
    else if (name in node && name !== 'list' && name !== 'style') node[name] = value;
    else if (name === 'style') node.style.cssText = value;
    else node.setAttribute(name, value);
  }
  node.append(...children);
  return node;
}

export function table(box, label) {
  const rows = element('tbody');
  const node = element('table', {}, rows);
  node.setAttribute('aria-label', label);
  box.append(node);
  return rows;
}

// Set the text of the row with the given name, adding the row first if needed. Unchanged texts are not touched. Without a
// text (null) the row is removed: the robot has no such thing.
export function cell(rows, name, text) {
  rows.cells ??= new Map();
  if (text === null) {
    rows.cells.get(name)?.parentElement.remove();
    rows.cells.delete(name);
    return;
  }
  if (!rows.cells.has(name)) {
    const value = element('td');
    rows.append(element('tr', {}, element('th', { scope: 'row' }, name), value));
    rows.cells.set(name, value);
  }
  const value = rows.cells.get(name);
  if (value.textContent !== text) value.textContent = text;
}

// Return the 2D context of a canvas resized to its element: units are CSS pixels, the resolution is that of the screen.
// `ratio` is height / width, by default that of the element. Return null while the canvas is hidden.
export function sizedPen(canvas, ratio) {
  const width = canvas.clientWidth, density = window.devicePixelRatio || 1;
  const height = ratio ? Math.round(width * ratio) : canvas.clientHeight;
  if (!width || !height) return null;
  const w = Math.round(width * density), h = Math.round(height * density);
  if (canvas.width !== w || canvas.height !== h) { canvas.width = w; canvas.height = h; }
  const pen = canvas.getContext('2d');
  pen.setTransform(density, 0, 0, density, 0, 0);
  pen.clearRect(0, 0, width, height);
  pen.width = width;
  pen.height = height;
  pen.lineJoin = 'round';
  pen.lineWidth = 1;
  return pen;
}

export function button(text, press, attributes = {}) {
  return element('button', { type: 'button', onclick: press, ...attributes }, text);
}

export function field(text, attributes = {}) {
  const input = element('input', attributes);
  return { input, label: element('label', {}, text, input) };
}

// A field for a length, shown in the unit of the page; `inches` gets and sets the value in inches.
export function lengthField(app, text, inches, attributes = {}, per = '') {
  const name = document.createTextNode(''), input = element('input', { type: 'number', step: 'any', ...attributes });
  const node = {
    input, label: element('label', {}, name, input),
    get inches() { return Number(input.value) * unitIn(app.metric); },
    set inches(value) { input.value = String(Math.round(value / unitIn(app.metric) * 100) / 100); },
  };
  let metric = app.metric;
  const relabel = () => { name.data = `${text}, ${unitName(app.metric)}${per}`; };
  app.onUnits(() => {
    const now = Number(input.value) * unitIn(metric);
    metric = app.metric;
    node.inches = now;
    relabel();
  });
  node.inches = inches;
  relabel();
  return node;
}

// A form: Enter does the same as its button.
export function form(submit, ...children) {
  return element('form', { onsubmit: (event) => { event.preventDefault(); submit(); } }, ...children);
}

// A selection list; offer(names, selected) updates its options, unless the user is just using it.
export function choice(text, attributes, change) {
  const select = element('select', { ...attributes, onchange: () => change(select.value) });
  const offer = (names, selected) => {
    if (select.dataset.names !== names.join()) select.replaceChildren(...names.map((name) => element('option', { value: name }, name)));
    select.dataset.names = names.join();
    if (document.activeElement !== select) select.value = selected;
  };
  return { select, label: element('label', {}, text, select), offer };
}

export function download(name, type, content) {
  const url = URL.createObjectURL(content instanceof Blob ? content : new Blob([content], { type }));
  const link = element('a', { href: url, download: name });
  link.click();
  setTimeout(() => URL.revokeObjectURL(url), 1000);
}
