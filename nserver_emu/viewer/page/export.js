// Exports: the map as PNG or SVG, and the run as one HTML file that replays without a server.
//
// A run contains the messages received since the page was opened, at most MAX_MESSAGES and MAX_SIZE characters. Older
// ones are merged into the complete picture with which it begins. It has a gap where the connection was lost, followed by a
// complete picture. The HTML file contains the modules and the style of this page and the run.

import { download } from './widgets.js';
import { drawScene } from './draw.js';
import { SvgPen, graphicsToSvg } from './svg.js';
import { updateShapes, updateBeams, MAX_TRACE_NUMBERS } from './scene.js';

const SAVED_TYPES = ['picture', 'localization', 'map', 'waypoints'];
const MAX_MESSAGES = 24000, MAX_SIZE = 60e6, MODULE = /(from|import) '\.\/([\w]+\.js)'/g;

export function newRun() { return { base: null, messages: [], sizes: [], size: 0 }; }

export function recordMessage(run, message, size = 0, max = { messages: MAX_MESSAGES, size: MAX_SIZE }) {
  if (!SAVED_TYPES.includes(message.type)) return;
  if (!run.base) { if (message.since === 0) run.base = message; return; }
  run.messages.push(message);
  run.sizes.push(size);
  run.size += size;
  while (run.messages.length > max.messages || (run.size > max.size && run.messages.length > 1)) {
    const oldest = run.messages.shift();
    run.size -= run.sizes.shift();
    if (oldest.type === 'picture') run.base = mergePictures(run.base, oldest);
  }
}

// Return the simulated time that a run covers, as text.
export function runLength(run) {
  const last = run.messages.findLast((message) => message.type === 'picture');
  return `${run.base && last ? Math.max(last.time_s - run.base.time_s, 0).toFixed(0) : 0} s`;
}

// Return the complete picture that a complete one and the next update make.
export function mergePictures(base, picture) {
  if (picture.since === 0) return picture;
  const traces = { ...base.traces };
  for (const [id, both] of Object.entries(picture.traces ?? {})) {
    traces[id] = Object.fromEntries(['actual', 'encoder'].map((name) => {
      const points = [...(traces[id]?.[name].points ?? []), ...both[name].points];
      return [name, { gone: both[name].gone, points: points.slice(-MAX_TRACE_NUMBERS) }];
    }));
  }
  const { drawn, ...rest } = picture;
  const graphics = drawn ? updateShapes(base.graphics, drawn) : rest.graphics ?? base.graphics;
  return { ...base, ...rest, since: 0, traces, graphics, beams: updateBeams(base.beams, picture.beams) };
}

export function savePng(app) {
  app.map.draw();
  app.map.canvas.toBlob((blob) => download('map.png', 'image/png', blob));
}

export function svgOf(app) {
  const { view } = app.map, pen = new SvgPen(view.width, view.height);
  drawScene(pen, app.scene, view, { ...app.map.options(), tool: undefined, graphics: graphicsToSvg });
  return pen.toString();
}

export function saveSvg(app) { download('map.svg', 'image/svg+xml', svgOf(app)); }

export async function saveRun(app) {
  const text = async (address) => (await fetch(address)).text();
  // 1. Collect all modules of the page, with import paths that an import map resolves.
  const modules = new Map();
  const gather = async (name) => {
    if (modules.has(name)) return;
    modules.set(name, '');
    const source = await text(`/page/${name}`);
    modules.set(name, source.replace(MODULE, "$1 'nserver/$2'"));
    for (const [, , other] of source.matchAll(MODULE)) await gather(other);
  };
  await gather('main.js');
  const imports = Object.fromEntries([...modules].map(([name, source]) =>
    [`nserver/${name}`, `data:text/javascript;charset=utf-8,${encodeURIComponent(source)}`]));
  // 2. Put modules, style and run into the page. A '<' in the data must not end the script element.
  const safe = (value) => JSON.stringify(value).replace(/</g, '\\u003c');
  const page = await text('/'), style = await text('/page/style.css');
  const whole = page
    .replace(/<link rel="stylesheet"[^>]*>/, () => `<style>${style}</style>`)
    .replace(/<script type="module"[^>]*><\/script>/, () => `<script>window.nserverRun = ${safe({ base: app.run.base, messages: app.run.messages })};</script>
<script type="importmap">${safe({ imports })}</script>
<script type="module">import 'nserver/main.js';</script>`);
  download('run.html', 'text/html', whole);
}
