// The websocket connection to the server: sends and receives messages, and reconnects after it is lost.

export const ACKNOWLEDGE_EVERY = 5;  // pictures between two acknowledgements; the server waits for them
const MIN_WAIT_MS = 250, MAX_WAIT_MS = 5000;

// onMessage(message, size) is called for each message that is not an answer, onState(name) when the connection changes.
export function openLink(token, { onMessage, onState }) {
  let socket = null, isRejected = false, wait_ms = MIN_WAIT_MS, requests = 0, pictures = 0;
  const pending = new Map();

  function open() {
    const scheme = location.protocol === 'https:' ? 'wss' : 'ws';
    socket = new WebSocket(`${scheme}://${location.host}/ws?token=${encodeURIComponent(token)}`);
    let wasOpen = false;
    socket.onopen = () => { wasOpen = true; wait_ms = MIN_WAIT_MS; onState('live'); };
    socket.onmessage = (event) => receive(JSON.parse(event.data), event.data.length);
    socket.onclose = () => {
      onState('lost');
      if (!wasOpen) checkToken();
      for (const resolve of pending.values()) resolve({ ok: false, error: 'the connection was lost' });
      pending.clear();
      setTimeout(() => { if (!isRejected) open(); }, wait_ms);
      wait_ms = Math.min(wait_ms * 2, MAX_WAIT_MS);
    };
  }

  // A restarted server has a new token: stop trying with the old one.
  async function checkToken() {
    try {
      const answer = await fetch(`/?token=${encodeURIComponent(token)}`);
      if (answer.status === 403) { isRejected = true; onState('rejected'); }
    } catch { /* the server does not respond: try again */ }
  }

  function receive(message, size) {
    if (message.type === 'picture') {
      pictures += 1;
      if (pictures % ACKNOWLEDGE_EVERY === 0) send({ do: 'seen', frame: message.frame });
    }
    if (message.type === 'answer' && pending.has(message.id)) {
      const resolve = pending.get(message.id);
      pending.delete(message.id);
      const { said: result, ...answer } = message;
      resolve({ ...answer, result });
    } else onMessage(message, size);
  }

  function send(message) { if (socket?.readyState === WebSocket.OPEN) socket.send(JSON.stringify(message)); }

  // Send a message that has an answer. Resolves to the answer; `ok` is false on errors.
  function request(message) {
    requests += 1;
    const id = requests;
    return new Promise((resolve) => {
      if (socket?.readyState !== WebSocket.OPEN) { resolve({ ok: false, error: 'not connected' }); return; }
      pending.set(id, resolve);
      send({ ...message, id });
    });
  }

  if (token) open(); else onState('no-token');
  return { send, request };
}
