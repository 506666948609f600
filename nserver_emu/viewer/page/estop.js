// Emergency stop: the keys that stop robots, and the banner with the button that releases them.
//
// Escape closes what is open, and with nothing open it stops the user's own robot: the selected one. The space bar stops it
// in any case, unless the focused element uses that key: a text field, or a control that was focused by keyboard.
// Shift+Space stops all robots, from anywhere.

const TEXT_FIELDS = 'textarea, input:not([type="checkbox"], [type="range"], [type="button"]), [contenteditable]';
const CONTROLS = 'button, summary, select, input';

// Whether the focused element was focused by pointer. Browsers report :focus-visible only after the first key.
let lastInputWasPointer = false, focusedByPointer = false;
document.addEventListener('pointerdown', () => { lastInputWasPointer = true; }, { capture: true });
document.addEventListener('keydown', (event) => { if (event.key !== ' ') lastInputWasPointer = false; }, { capture: true });
document.addEventListener('focusin', () => { focusedByPointer = lastInputWasPointer; });

function usesSpace(target) { return target.matches?.(TEXT_FIELDS) || (target.matches?.(CONTROLS) && !focusedByPointer); }

// closeOpen() closes what is open, and returns false if nothing is.
export function setUpStopKeys({ closeOpen, stopMine, stopAll }) {
  let isSpaceDown = false;
  document.addEventListener('keydown', (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.key === 'Escape') {
      if (!event.repeat && !closeOpen()) stopMine();
    } else if (event.key === ' ' && (event.shiftKey || !usesSpace(event.target))) {
      event.preventDefault();
      isSpaceDown = true;
      if (!event.repeat) (event.shiftKey ? stopAll : stopMine)();
    }
  }, { capture: true });
  // A button is pressed when the space bar is released: suppress that, too.
  document.addEventListener('keyup', (event) => {
    if (event.key !== ' ' || !isSpaceDown) return;
    isSpaceDown = false;
    event.preventDefault();
  }, { capture: true });
}

// Stop a robot, or all without a number, until release. Return an error text, or ''.
export async function stop(link, robot) {
  const answer = await link.request(robot === undefined ? { do: 'stop' } : { do: 'stop', robot });
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

// Release what this page has stopped; if it has stopped none, all robots.
async function release(app) {
  const robots = app.ownRobot !== null ? [Number(app.ownRobot)] : robotsToRelease(app.scene.robots, app.name);
  const answers = await Promise.all(robots.map((robot) => app.link.request(robot === null ? { do: 'release' } : { do: 'release', robot })));
  const failed = answers.find((answer) => !answer.ok);
  app.notice(failed ? `NOT RELEASED — ${failed.error}` : '', { stays: true });
}

// Return the numbers of the robots that Release of this viewer releases; [null] for all.
export function robotsToRelease(robots, viewerName) {
  const stopped = Object.keys(robots).filter((id) => robots[id].held), own = stopped.filter((id) => robots[id].held.by === viewerName);
  return own.length && own.length < stopped.length ? own.map(Number) : [null];
}
