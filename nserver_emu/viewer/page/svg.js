// A pen that writes what is drawn down as SVG: the part of a canvas' 2D context that draw.js uses, no more.

const TURN = 2 * Math.PI;
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
  drawImage() { throw new Error('a drawing holds no pictures'); }

  // From an angle to another, clockwise on the screen unless `back`; a whole turn is two halves.
  ellipse(x, y, rx, ry, turn, from, to, back = false) {
    let sweep = back ? from - to : to - from;
    sweep = Math.abs(sweep) >= TURN ? TURN : ((sweep % TURN) + TURN) % TURN;
    const at = (angle) => {
      const ex = rx * Math.cos(angle), ey = ry * Math.sin(angle);
      return [x + ex * Math.cos(turn) - ey * Math.sin(turn), y + ex * Math.sin(turn) + ey * Math.cos(turn)];
    };
    const way = back ? -1 : 1, pieces = sweep > Math.PI ? 2 : 1;
    this.lineTo(...at(from));
    if (sweep === TURN) this.path = this.path.replace(/L([^L]*)$/, 'M$1');
    for (let k = 1; k <= pieces; k += 1) {
      const [ex, ey] = at(from + way * sweep * k / pieces);
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
