// SVG output of the map: SvgPen has the part of a canvas' 2D context that draw.js uses.

import { drawShape } from './draw.js';
import { clientColour } from './colours.js';

const TURN = 2 * Math.PI;
// Masks grow with the square of the number of shapes: more are drawn without.
const MAX_MASKED = 400;
const n = (value) => String(Math.round(value * 100) / 100);
const escaped = (text) => String(text).replace(/[&<>"]/g, (sign) => ({ '&': '&amp;', '<': '&lt;', '>': '&gt;', '"': '&quot;' })[sign]);

export class SvgPen {
  constructor(width, height) {
    this.width = width;
    this.height = height;
    this.fillStyle = this.strokeStyle = '#000000';
    this.lineWidth = 1;
    this.globalAlpha = 1;
    this.font = '12px sans-serif';
    this.parts = [];
    this.path = '';
    this.dash = [];
  }

  beginPath() { this.path = ''; }
  moveTo(x, y) { this.path += `M${n(x)} ${n(y)}`; }
  lineTo(x, y) { this.path += `${this.path ? 'L' : 'M'}${n(x)} ${n(y)}`; }
  closePath() { this.path += 'Z'; }
  arc(x, y, r, from, to, back = false) { this.ellipse(x, y, r, r, 0, from, to, back); }
  setLineDash(dash) { this.dash = dash; }
  drawImage() { throw new Error('an SVG drawing cannot contain images'); }

  // An arc from one angle to another, clockwise on the screen unless `back`. SVG needs two arcs for more than half a turn.
  ellipse(x, y, rx, ry, turn, from, to, back = false) {
    let sweep = back ? from - to : to - from;
    sweep = Math.abs(sweep) >= TURN ? TURN : ((sweep % TURN) + TURN) % TURN;
    const at = (angle) => {
      const ex = rx * Math.cos(angle), ey = ry * Math.sin(angle);
      return [x + ex * Math.cos(turn) - ey * Math.sin(turn), y + ex * Math.sin(turn) + ey * Math.cos(turn)];
    };
    const sign = back ? -1 : 1, parts = sweep > Math.PI ? 2 : 1;
    this.lineTo(...at(from));
    if (sweep === TURN) this.path = this.path.replace(/L([^L]*)$/, 'M$1');
    for (let k = 1; k <= parts; k += 1) {
      const [ex, ey] = at(from + sign * sweep * k / parts);
      this.path += `A${n(rx)} ${n(ry)} ${n(turn * 180 / Math.PI)} 0 ${back ? 0 : 1} ${n(ex)} ${n(ey)}`;
    }
  }

  fill() { this.put(`<path d="${this.path}" fill="${escaped(this.fillStyle)}"${this.alpha()}/>`); }

  stroke() {
    const dash = this.dash.length ? ` stroke-dasharray="${this.dash.join(' ')}"` : '';
    this.put(`<path d="${this.path}" fill="none" stroke="${escaped(this.strokeStyle)}" stroke-width="${n(this.lineWidth)}" stroke-linejoin="round"${dash}${this.alpha()}/>`);
  }

  fillRect(x, y, w, h) {
    this.put(`<rect x="${n(x)}" y="${n(y)}" width="${n(w)}" height="${n(h)}" fill="${escaped(this.fillStyle)}"${this.alpha()}/>`);
  }

  fillText(text, x, y) {
    const size = parseFloat(this.font);
    this.put(`<text x="${n(x)}" y="${n(y)}" font-family="sans-serif" font-size="${size}" fill="${escaped(this.fillStyle)}"${this.alpha()}>${escaped(text)}</text>`);
  }

  alpha() { return this.globalAlpha < 1 ? ` opacity="${n(this.globalAlpha)}"` : ''; }
  put(part) { this.parts.push(part); }

  toString() {
    return `<svg xmlns="http://www.w3.org/2000/svg" width="${n(this.width)}" height="${n(this.height)}" `
      + `viewBox="0 0 ${n(this.width)} ${n(this.height)}">\n${this.parts.join('\n')}\n</svg>\n`;
  }
}

// Draw the client graphics as SVG. Shapes in XOR mode cancel where they overlap, as on the canvas. SVG has no XOR, so each
// shape is masked by the shapes that cancel it: a shape in XOR mode by all shapes before it and the XOR shapes after it,
// any other by the XOR shapes after it. Where three or more shapes overlap, only the canvas is exact.
export function graphicsToSvg(pen, scene, view, { theme }) {
  const shapes = scene.graphics.map((shape) => ({ xor: shape[4], text: shapeSvg(shape, view, clientColour(shape[3], theme)),
    black: shapeSvg(shape, view, '#000000'), box: bounds(shapeSvg(shape, view, '#000000')) }));
  const isMasked = shapes.length <= MAX_MASKED;
  shapes.forEach((shape, k) => {
    const cancelling = isMasked ? shapes.filter((other, j) => j !== k && (shape.xor ? j < k || other.xor : j > k && other.xor)
      && overlap(shape.box, other.box)) : [];
    if (!cancelling.length) { pen.put(shape.text); return; }
    pen.put(`<mask id="xor${k}" maskUnits="userSpaceOnUse" x="0" y="0" width="${view.width}" height="${view.height}">`
      + `<rect width="${view.width}" height="${view.height}" fill="#ffffff"/>${cancelling.map((other) => other.black).join('')}</mask>`);
    pen.put(`<g mask="url(#xor${k})">${shape.text}</g>`);
  });
}

function shapeSvg(shape, view, colour) {
  const pen = new SvgPen(view.width, view.height);
  drawShape(pen, shape, view, colour);
  return pen.parts.join('');
}

// Return the bounding box of a shape's paths; a generous one for arcs.
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

function overlap([a, b, c, d], [e, f, g, h]) { return a <= g && e <= c && b <= h && f <= d; }
