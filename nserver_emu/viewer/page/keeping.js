// Pictures to keep: the map as PNG and SVG, and the run as one HTML file that replays without a server.
//
// The run is what came over the link since the page was opened, the last MOST_KEPT messages of it and the last MOST_SIZE
// characters; what was before them is folded into one whole picture that it begins with. Where the link was lost there is
// a gap in it, and then a whole picture. The file holds this page's own modules, style and run.

import { download } from './parts.js';
import { drawScene } from './draw.js';
import { SvgPen } from './svg.js';
import { drawnOn, beamsOn } from './scene.js';
import { graphicsToSvg } from './svg_graphics.js';

const KEPT = ['picture', 'localization', 'waypoints'];
const MOST_KEPT = 24000, MOST_SIZE = 60e6, MOST_TRACE_NUMBERS = 8000, MODULE = /(from|import) '\.\/([\w]+\.js)'/g;

export function newRun() { return { base: null, messages: [], sizes: [], size: 0 }; }

export function keepMessage(run, message, size = 0, most = { kept: MOST_KEPT, size: MOST_SIZE }) {
  if (!KEPT.includes(message.type)) return;
  if (!run.base) { if (message.since === 0) run.base = message; return; }
  run.messages.push(message);
  run.sizes.push(size);
  run.size += size;
  while (run.messages.length > most.kept || (run.size > most.size && run.messages.length > 1)) {
    const oldest = run.messages.shift();
    run.size -= run.sizes.shift();
    if (oldest.type === 'picture') run.base = folded(run.base, oldest);
  }
}

// How much simulated time a run holds, in words.
export function runLength(run) {
  const last = run.messages.findLast((message) => message.type === 'picture');
  return `${run.base && last ? Math.max(last.time_s - run.base.time_s, 0).toFixed(0) : 0} s of it`;
}

// The whole picture that a whole one and the next make.
export function folded(base, picture) {
  if (picture.since === 0) return picture;
  const traces = { ...base.traces };
  for (const [id, both] of Object.entries(picture.traces ?? {})) {
    traces[id] = Object.fromEntries(['actual', 'encoder'].map((name) => {
      const points = [...(traces[id]?.[name].points ?? []), ...both[name].points];
      return [name, { gone: both[name].gone, points: points.slice(-MOST_TRACE_NUMBERS) }];
    }));
  }
  const { drawn, ...rest } = picture;
  const graphics = drawn ? drawnOn(base.graphics, drawn) : rest.graphics ?? base.graphics;
  return { ...base, ...rest, since: 0, traces, graphics, beams: beamsOn(base.beams, picture.beams) };
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
  const safe = (value) => JSON.stringify(value).replace(/</g, '\\u003c');
  const page = await text('/'), style = await text('/page/style.css');
  const whole = page
    .replace(/<link rel="stylesheet"[^>]*>/, () => `<style>${style}</style>`)
    .replace(/<script type="module"[^>]*><\/script>/, () => `<script>window.nserverRun = ${safe({ base: app.run.base, messages: app.run.messages })};</script>
<script type="importmap">${safe({ imports })}</script>
<script type="module">import 'nserver/main.js';</script>`);
  download('run.html', 'text/html', whole);
}
