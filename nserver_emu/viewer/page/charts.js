// Charts over time: the latest value at the right, seconds below, values at the left; legends are HTML text.

import { sizedPen, element } from './widgets.js';

const LEFT = 40, BOTTOM = 16;

// A line is interrupted where there was nothing for longer than this.
const GAP_S = 1;

// lines: [{points: [[time_s, value] ...], colour, dots}]; a value of null interrupts the line. bands: [{points:
// [[time_s, low, high] ...], colour}], filled areas. bound: a value marked by a horizontal line.
export function chart(canvas, theme, { end_s, span_s, lines, bands = [], bound }) {
  const pen = sizedPen(canvas, 0.34);
  if (!pen) return;
  // Samples older than the axis are not drawn.
  const recent = ({ points, ...rest }) => ({ ...rest, runs: runsOf(points.filter(([time_s]) => time_s >= end_s - span_s)) });
  const shownLines = lines.map(recent), shownBands = bands.map(recent);
  const values = [...shownLines, ...shownBands].flatMap(({ runs }) => runs.flat().flatMap(([, ...numbers]) => numbers)).concat(bound ?? []);
  const low = Math.min(0, ...values), high = Math.max(1e-3, ...values), wide = pen.width - LEFT - 6, tall = pen.height - BOTTOM - 8;
  const at = (time_s, value) => [LEFT + wide * (1 - (end_s - time_s) / span_s), 6 + tall - (value - low) / (high - low) * tall];
  pen.font = '11px system-ui, sans-serif';
  // Horizontal lines at the limits, 0 and the bound; labels that would overlap are omitted.
  let lastAt = Infinity;
  for (const value of [...new Set([low, 0, ...(bound ? [bound] : []), high])].sort((a, b) => a - b)) {
    const [, py] = at(end_s, value);
    pen.strokeStyle = value === bound ? theme.hit : theme.edge;
    pen.setLineDash(value === bound ? [4, 3] : []);
    pen.beginPath(); pen.moveTo(LEFT, py); pen.lineTo(pen.width - 6, py); pen.stroke();
    pen.fillStyle = theme.quiet;
    if (lastAt - py > 11) { pen.fillText(value.toFixed(1), 2, py + 4); lastAt = py; }
  }
  pen.setLineDash([]);
  timeAxis(pen, theme, { left: LEFT, right: pen.width - 6, y: pen.height - 3, span_s });
  for (const { runs, colour } of shownBands) {
    pen.fillStyle = colour;
    pen.globalAlpha = 0.2;
    for (const run of runs) {
      // Along the upper limit, and back along the lower one.
      const outline = [...run.map(([time_s, , top]) => at(time_s, top)), ...run.map(([time_s, bottom]) => at(time_s, bottom)).reverse()];
      pen.beginPath();
      outline.forEach(([px, py], k) => (k ? pen.lineTo : pen.moveTo).call(pen, px, py));
      pen.fill();
    }
    pen.globalAlpha = 1;
  }
  for (const { runs, colour, dots } of shownLines) {
    pen.strokeStyle = pen.fillStyle = colour;
    pen.lineWidth = 1.5;
    pen.beginPath();
    for (const run of runs) {
      run.forEach(([time_s, value], k) => {
        const [px, py] = at(time_s, value);
        if (dots) pen.fillRect(px - 1.5, py - 1.5, 3, 3); else (k ? pen.lineTo : pen.moveTo).call(pen, px, py);
      });
    }
    pen.stroke();
  }
}

// Return points as runs without a gap: a point with null ends a run, and so does a longer time without points.
export function runsOf(points, gap_s = GAP_S) {
  const runs = [];
  let before = null;
  for (const point of points) {
    const isNothing = point.includes(null);
    if (!isNothing) {
      if (!before || point[0] - before[0] > gap_s) runs.push([]);
      runs[runs.length - 1].push(point);
    }
    before = isNothing ? null : point;
  }
  return runs;
}

// Label the time axis: seconds before now.
export function timeAxis(pen, theme, { left, right, y, span_s }) {
  pen.fillStyle = theme.quiet;
  pen.textAlign = 'center';
  for (const fraction of [0.25, 0.5, 0.75]) pen.fillText(`−${Math.round(span_s * (1 - fraction))} s`, left + fraction * (right - left), y);
  pen.textAlign = 'left';
  pen.fillText(`−${span_s} s`, left, y);
  pen.textAlign = 'right';
  pen.fillText('now', right, y);
  pen.textAlign = 'left';
}

// Entries: [name of a theme colour, meaning] ...
export function legend(...entries) {
  return element('div', { className: 'legend' }, ...entries.map(([colour, text]) =>
    element('span', {}, element('i', { style: `background: var(--${colour})` }), text)));
}
