// The token that the page was opened with: taken out of the address bar, where others look on and browsers remember it,
// and kept by this tab for as long as it lasts, so that a reload has it still.

const KEY = 'nserver token';

export function takeToken() {
  const said = new URLSearchParams(location.search).get('token');
  try {
    if (said === null) return sessionStorage.getItem(KEY) ?? '';
    sessionStorage.setItem(KEY, said);
    history.replaceState(null, '', location.pathname);
  } catch { /* a browser that keeps nothing: it stays in the address */ }
  return said ?? '';
}
