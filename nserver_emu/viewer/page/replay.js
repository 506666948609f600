// Replays a saved run: replaces the connection by the messages of the run, with controls to play and seek.

import { element, button } from './widgets.js';

export function openReplay(run, { onMessage, onReset, onState }) {
  const messages = [{ ...run.base, type: 'picture' }, ...run.messages];
  // Messages without a time have that of the picture before them.
  const times = messages.map(() => 0);
  messages.forEach((message, k) => { times[k] = message.type === 'picture' ? message.time_s : times[Math.max(k - 1, 0)]; });
  const first = times[0], last = times[times.length - 1];
  let next = 0, now_s = first, playing = false, before = null;

  const slider = element('input', { type: 'range', min: first, max: last, step: 'any', value: first, id: 'replay-time' });
  slider.setAttribute('aria-label', 'Time of the run, seconds');
  const play = button('Play', () => go(!playing), { id: 'replay-play', title: 'Play or pause (space bar)' });
  const position = element('span', { id: 'replay-now' });
  const rate = element('select', { id: 'replay-rate' }, ...[0.5, 1, 2, 5, 10].map((factor) => element('option', { value: factor }, `${factor} x`)));
  rate.value = '1';
  rate.setAttribute('aria-label', 'Speed');
  document.querySelector('header').append(play, slider, position, rate);
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
    if (time_s < now_s) { next = 0; onReset(); }  // replay from the start
    now_s = time_s;
    while (next < messages.length && times[next] <= now_s) { onMessage(messages[next]); next += 1; }
    const text = `${(now_s - first).toFixed(1)} of ${(last - first).toFixed(1)} s`;
    if (position.textContent !== text) position.textContent = text;
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

  onReset();
  onState('replay');
  queueMicrotask(() => seek(first));
  requestAnimationFrame(frame);
  return { send() {}, request: async () => ({ ok: false, error: 'this is a saved run' }), seek, last };
}
