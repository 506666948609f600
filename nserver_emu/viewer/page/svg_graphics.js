// What clients drew, as SVG: shapes in XOR cancel where they meet another, as on the canvas. SVG has no XOR of what is
// painted, so each shape is masked by those that cancel it: in XOR by every shape before it and by those in XOR after it,
// else by those in XOR after it. Where three and more meet at a point it is the canvas that is right.

import { drawShape } from './draw.js';
import { clientColour } from './colours.js';
import { SvgPen } from './svg.js';

const MOST_MASKED = 400;

export function graphicsToSvg(pen, scene, view, { theme }) {
  const shapes = scene.graphics.map((shape) => ({ xor: shape[4], text: drawn(shape, view, clientColour(shape[3], theme)),
    black: drawn(shape, view, '#000000'), box: bounds(drawn(shape, view, '#000000')) }));
  const masked = shapes.length <= MOST_MASKED;
  shapes.forEach((shape, k) => {
    const against = masked ? shapes.filter((other, j) => j !== k && (shape.xor ? j < k || other.xor : j > k && other.xor)
      && meet(shape.box, other.box)) : [];
    if (!against.length) { pen.put(shape.text); return; }
    pen.put(`<mask id="xor${k}" maskUnits="userSpaceOnUse" x="0" y="0" width="${view.width}" height="${view.height}">`
      + `<rect width="${view.width}" height="${view.height}" fill="#ffffff"/>${against.map((other) => other.black).join('')}</mask>`);
    pen.put(`<g mask="url(#xor${k})">${shape.text}</g>`);
  });
}

function drawn(shape, view, colour) {
  const pen = new SvgPen(view.width, view.height);
  drawShape(pen, shape, view, colour);
  return pen.parts.join('');
}

// The box around all numbers of the paths of a shape; of an arc a generous one.
function bounds(text) {
  const xs = [], ys = [];
  for (const [, letter, numbers] of text.matchAll(/([MLA])([-\d. ]+)/g)) {
    const n = numbers.trim().split(' ').map(Number), reach = letter === 'A' ? 2 * Math.max(n[0], n[1]) : 2;
    const [x, y] = letter === 'A' ? n.slice(5) : n;
    xs.push(x - reach, x + reach);
    ys.push(y - reach, y + reach);
  }
  return [Math.min(...xs), Math.min(...ys), Math.max(...xs), Math.max(...ys)];
}

function meet([a, b, c, d], [e, f, g, h]) { return a <= g && e <= c && b <= h && f <= d; }
