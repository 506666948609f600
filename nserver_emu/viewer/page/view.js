// Where on the screen a place of the world is: a middle, a scale, a size. Plain numbers, y upwards in the world.

export function newView() { return { x: 0, y: 0, scale: 4, width: 100, height: 100 }; }

export function toScreen(view, x, y) {
  return [view.width / 2 + (x - view.x) * view.scale, view.height / 2 - (y - view.y) * view.scale];
}

export function toWorld(view, px, py) {
  return [view.x + (px - view.width / 2) / view.scale, view.y - (py - view.height / 2) / view.scale];
}

export function zoomAt(view, factor, px, py) {
  const [x, y] = toWorld(view, px, py);
  view.scale = Math.min(Math.max(view.scale * factor, 0.02), 400);
  const [x2, y2] = toWorld(view, px, py);
  view.x += x - x2;
  view.y += y - y2;
}

export function pan(view, dx, dy) { view.x -= dx / view.scale; view.y += dy / view.scale; }

export function fitTo(view, [x1, y1, x2, y2]) {
  const margin = 24, ruler = 14;  // the scale bar stands below
  const across = (view.width - 2 * margin) / Math.max(x2 - x1, 1);
  const up = (view.height - 2 * margin - ruler) / Math.max(y2 - y1, 1);
  view.scale = Math.max(Math.min(across, up), 0.02);
  view.x = (x1 + x2) / 2;
  view.y = (y1 + y2) / 2 - ruler / 2 / view.scale;
}

// The length of a grid step or scale bar that is at least so many pixels: 1, 2 or 5 times a power of ten of the unit.
export function roundLength(scale, atLeastPx, unitIn) {
  const least = atLeastPx / (scale * unitIn);
  const power = 10 ** Math.floor(Math.log10(least));
  return [1, 2, 5, 10].map((k) => k * power).find((length) => length >= least * 0.999999) * unitIn;
}
