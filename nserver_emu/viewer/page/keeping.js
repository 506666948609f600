// Pictures to keep: the map as PNG and SVG, and the run as one HTML file that replays without a server.
//
// The run is what came over the link since the page was opened, the last MOST_KEPT messages of it; what was before
// them is folded into one whole picture that it begins with. The file holds this page's own modules, style and run.

import { download } from './parts.js';
import { drawScene, drawGraphics } from './draw.js';
import { SvgPen } from './svg.js';

const MOST_KEPT = 12000, MOST_TRACE_NUMBERS = 8000, MODULE = /(from|import) '\.\/([\w]+\.js)'/g;

export function newRun() { return { base: null, messages: [] }; }

export function keepMessage(run, message) {
  if (message.type === 'picture' && message.since === 0) { run.base = message; run.messages = []; return; }
  if (!run.base || !['picture', 'localization'].includes(message.type)) return;
  run.messages.push(message);
  if (run.messages.length > MOST_KEPT) {
    const oldest = run.messages.shift();
    if (oldest.type === 'picture') run.base = folded(run.base, oldest);
  }
}

// The whole picture that a whole one and the next make.
export function folded(base, picture) {
  const traces = { ...base.traces };
  for (const [id, both] of Object.entries(picture.traces ?? {})) {
    traces[id] = Object.fromEntries(['actual', 'encoder'].map((name) => {
      const points = [...(traces[id]?.[name].points ?? []), ...both[name].points];
      return [name, { gone: both[name].gone, points: points.slice(-MOST_TRACE_NUMBERS) }];
    }));
  }
  return { ...base, ...picture, since: 0, traces };
}

export function savePng(app) {
  app.map.draw();
  app.map.canvas.toBlob((blob) => download('map.png', 'image/png', blob));
}

export function svgOf(app) {
  const { view } = app.map, pen = new SvgPen(view.width, view.height);
  drawScene(pen, app.scene, view, { ...app.map.options(), tool: undefined, graphics: drawGraphics });
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
  const page = await text(`/${location.search}`), style = await text('/page/style.css');
  const whole = page
    .replace(/<link rel="stylesheet"[^>]*>/, () => `<style>${style}</style>`)
    .replace(/<script type="module"[^>]*><\/script>/, () => `<script>window.nserverRun = ${safe(app.run)};</script>
<script type="importmap">${safe({ imports })}</script>
<script type="module">import 'nserver/main.js';</script>`);
  download('run.html', 'text/html', whole);
}
