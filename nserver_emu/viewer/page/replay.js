// Replays a run that was kept: the link's place is taken by the messages of the run and a bar to go through them.

import { element, button } from './parts.js';

export function openReplay(run, { hear, reset, state }) {
  const messages = [{ ...run.base, type: 'picture' }, ...run.messages];
  const times = messages.map(() => 0);
  messages.forEach((message, k) => { times[k] = message.type === 'picture' ? message.time_s : times[Math.max(k - 1, 0)]; });
  const first = times[0], last = times[times.length - 1];
  let next = 0, now_s = first, playing = false, before = null;

  const slider = element('input', { type: 'range', min: first, max: last, step: 'any', value: first, id: 'replay-time' });
  slider.setAttribute('aria-label', 'Time of the run, seconds');
  const play = button('Play', () => go(!playing), { id: 'replay-play', title: 'Play or pause (space bar)' });
  const shown = element('span', { id: 'replay-now' });
  const rate = element('select', { id: 'replay-rate' }, ...[0.5, 1, 2, 5, 10].map((factor) => element('option', { value: factor }, `${factor} x`)));
  rate.value = '1';
  rate.setAttribute('aria-label', 'Speed');
  document.querySelector('header').append(play, slider, shown, rate);
  slider.addEventListener('input', () => seek(Number(slider.value)));
  document.addEventListener('keydown', (event) => {
    if (event.key !== ' ' || event.target.closest?.('button, select, summary')) return;
    event.preventDefault();
    go(!playing);
  });

  function go(on) {
    if (on && now_s >= last) seek(first);
    playing = on;
    before = null;
    play.textContent = on ? 'Pause' : 'Play';
  }

  function seek(time_s) {
    if (time_s < now_s) { next = 0; reset(); }
    now_s = time_s;
    while (next < messages.length && times[next] <= now_s) { hear(messages[next]); next += 1; }
    const text = `${(now_s - first).toFixed(1)} of ${(last - first).toFixed(1)} s`;
    if (shown.textContent !== text) shown.textContent = text;
    slider.setAttribute('aria-valuetext', text);
  }

  function frame(now_ms) {
    if (playing) {
      if (before !== null) seek(Math.min(last, now_s + (now_ms - before) / 1000 * Number(rate.value)));
      before = now_ms;
      slider.value = now_s;
      if (now_s >= last) go(false);
    }
    requestAnimationFrame(frame);
  }

  reset();
  state('replay');
  queueMicrotask(() => seek(first));
  requestAnimationFrame(frame);
  return { send() {}, ask: async () => ({ ok: false, error: 'this is a run that was kept' }), seek, last };
}
