// Values stored by the browser: the access token of this tab, and preferences (layers, units, closed windows).
// A browser may forbid storage; then the token stays in the address and preferences last until the page is closed.

const TOKEN_KEY = 'nserver token', PREFIX = 'nserver ';

// Return the token from the address or from an earlier load in this tab. The token is removed from the address bar,
// where others could read it and the browser history would store it.
export function takeToken() {
  const given = new URLSearchParams(location.search).get('token');
  try {
    if (given === null) return sessionStorage.getItem(TOKEN_KEY) ?? '';
    sessionStorage.setItem(TOKEN_KEY, given);
    history.replaceState(null, '', location.pathname);
  } catch { /* storage is disabled: the token stays in the address */ }
  return given ?? '';
}

export function savePreference(name, value) {
  try { localStorage.setItem(PREFIX + name, JSON.stringify(value)); } catch { /* storage is disabled */ }
}

export function loadPreference(name, fallback) {
  try { return JSON.parse(localStorage.getItem(PREFIX + name)) ?? fallback; } catch { return fallback; }
}
