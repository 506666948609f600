// Stopping by key, wherever the focus is: Escape always; the space bar unless it means something where the focus is: in
// a text, or on a button that was reached by keyboard.

const TYPED = 'textarea, input:not([type="checkbox"], [type="range"], [type="button"]), [contenteditable]';
const PRESSED = 'button, summary, select, input';

// Whether the focus came where it is by a pointer: browsers call it visible from the first key on.
let pointed = false, byPointer = false;
document.addEventListener('pointerdown', () => { pointed = true; }, { capture: true });
document.addEventListener('keydown', (event) => { if (event.key !== ' ') pointed = false; }, { capture: true });
document.addEventListener('focusin', () => { byPointer = pointed; });

export function meansStop(event) {
  if (event.ctrlKey || event.metaKey || event.altKey) return false;
  if (event.key === 'Escape') return true;
  if (event.key !== ' ') return false;
  const { target } = event;
  return !(target.matches?.(TYPED) || (target.matches?.(PRESSED) && !byPointer));
}

export function setUpStopping(stop) {
  let held = false;
  document.addEventListener('keydown', (event) => {
    if (!meansStop(event)) return;
    if (event.key === ' ') { event.preventDefault(); held = true; }
    if (!event.repeat) stop();
  }, { capture: true });
  document.addEventListener('keyup', (event) => {
    if (event.key !== ' ' || !held) return;
    held = false;
    event.preventDefault();
  }, { capture: true });
}

// Has every robot stand until it is released; why that could not be told, or nothing.
export async function stopAll(link) {
  const answer = await link.ask({ do: 'stop' });
  return answer.ok ? '' : `NOT STOPPED — ${answer.error}`;
}
