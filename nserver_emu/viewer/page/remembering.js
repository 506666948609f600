// What of the page's looks outlives a reload: layers, units, windows that are closed. In the browser's own store, where
// there is one; nothing of the daemon or its token.

const PREFIX = 'nserver ';

export function remember(name, value) {
  try { localStorage.setItem(PREFIX + name, JSON.stringify(value)); } catch { /* a browser that keeps nothing */ }
}

export function remembered(name, otherwise) {
  try { return JSON.parse(localStorage.getItem(PREFIX + name)) ?? otherwise; } catch { return otherwise; }
}
