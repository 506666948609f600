// Emergency stop: the keys that stop all robots, and the banner with the button that releases them.
//
// Escape always stops. The space bar stops unless the focused element uses it: a text field, or a control that was
// focused by keyboard.

const TEXT_FIELDS = 'textarea, input:not([type="checkbox"], [type="range"], [type="button"]), [contenteditable]';
const CONTROLS = 'button, summary, select, input';

// Whether the focused element was focused by pointer. Browsers report :focus-visible only after the first key.
let lastInputWasPointer = false, focusedByPointer = false;
document.addEventListener('pointerdown', () => { lastInputWasPointer = true; }, { capture: true });
document.addEventListener('keydown', (event) => { if (event.key !== ' ') lastInputWasPointer = false; }, { capture: true });
document.addEventListener('focusin', () => { focusedByPointer = lastInputWasPointer; });

function isStopKey(event) {
  if (event.ctrlKey || event.metaKey || event.altKey) return false;
  if (event.key === 'Escape') return true;
  if (event.key !== ' ') return false;
  const { target } = event;
  return !(target.matches?.(TEXT_FIELDS) || (target.matches?.(CONTROLS) && !focusedByPointer));
}

export function setUpStopKeys(stop) {
  let isSpaceDown = false;
  document.addEventListener('keydown', (event) => {
    if (!isStopKey(event)) return;
    if (event.key === ' ') { event.preventDefault(); isSpaceDown = true; }
    if (!event.repeat) stop();
  }, { capture: true });
  // A button is pressed when the space bar is released: suppress that, too.
  document.addEventListener('keyup', (event) => {
    if (event.key !== ' ' || !isSpaceDown) return;
    isSpaceDown = false;
    event.preventDefault();
  }, { capture: true });
}

// Stop all robots until they are released. Return an error text, or ''.
export async function stopAll(link) {
  const answer = await link.request({ do: 'stop' });
  return answer.ok ? '' : `NOT STOPPED — ${answer.error}`;
}

// Return the texts of the banner, or null if no robot is stopped. `viewerName` is the name of this viewer.
export function bannerTexts(robots, viewerName) {
  const all = Object.keys(robots), stopped = all.filter((id) => robots[id].held);
  if (!stopped.length) return null;
  const by = [...new Set(stopped.map((id) => robots[id].held.by))].map((name) => (name === viewerName ? `you (${name})` : name));
  const ignored = stopped.reduce((sum, id) => sum + robots[id].held.ignored, 0);
  return {
    state: `Stopped: ${stoppedText(stopped, all)} until Release. Stopped by ${by.join(' and ')}.`,
    ignored: ignored ? `${ignored} motion ${ignored === 1 ? 'command' : 'commands'} ignored.` : '',
  };
}

function stoppedText(stopped, all) {
  if (stopped.length === all.length) return 'no robot moves';
  return stopped.length === 1 ? `robot ${stopped[0]} does not move` : `robots ${stopped.join(', ')} do not move`;
}

// Set up the banner and return the function that updates it. Only the state is announced to screen readers: the count
// of ignored commands changes too often.
export function setUpBanner(app) {
  const banner = document.getElementById('estop-banner');
  const parts = { state: document.getElementById('estop-state'), ignored: document.getElementById('estop-ignored') };
  document.getElementById('release').addEventListener('click', () => release(app));
  document.addEventListener('keydown', (event) => {
    if (event.key !== 'R' || !event.shiftKey || event.repeat || event.ctrlKey || event.metaKey || event.altKey) return;
    if (banner.hidden || !app.mayAct || event.target.matches?.('input, textarea, select')) return;
    event.preventDefault();
    release(app);
  });
  return () => {
    const texts = bannerTexts(app.scene.robots, app.name);
    banner.hidden = !texts;
    for (const [name, part] of Object.entries(parts)) {
      const text = texts?.[name] ?? '';
      if (part.textContent !== text) part.textContent = text;  // an unchanged text is not announced again
    }
  };
}

async function release(app) {
  const answer = await app.link.request({ do: 'release' });
  app.notice(answer.ok ? '' : `NOT RELEASED — ${answer.error}`);
}
