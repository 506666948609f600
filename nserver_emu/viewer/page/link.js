// The websocket to the daemon: messages in, messages out, and again when it was lost. A sleeping tab catches up: what
// comes is taken in at once, drawn when there is something to draw on.

export const ACKNOWLEDGE_EVERY = 5;

export function openLink(token, { hear, state }) {
  let socket = null, refused = false, wait_ms = 250, asked = 0, pictures = 0;
  const answers = new Map();

  function open() {
    const scheme = location.protocol === 'https:' ? 'wss' : 'ws';
    socket = new WebSocket(`${scheme}://${location.host}/ws?token=${encodeURIComponent(token)}`);
    let opened = false;
    socket.onopen = () => { opened = true; wait_ms = 250; state('live'); };
    socket.onmessage = (event) => take(JSON.parse(event.data), event.data.length);
    socket.onclose = () => {
      state('lost');
      if (!opened) lookWhy();
      for (const then of answers.values()) then({ ok: false, error: 'the connection was lost' });
      answers.clear();
      setTimeout(() => { if (!refused) open(); }, wait_ms);
      wait_ms = Math.min(wait_ms * 2, 5000);
    };
  }

  // A daemon that was started anew has another token: the page would knock for ever.
  async function lookWhy() {
    try {
      const answer = await fetch(`/?token=${encodeURIComponent(token)}`);
      if (answer.status === 403) { refused = true; state('refused'); }
    } catch { /* nobody there: it is tried again */ }
  }

  function take(message, size) {
    if (message.type === 'picture') {
      pictures += 1;
      if (pictures % ACKNOWLEDGE_EVERY === 0) send({ do: 'seen', frame: message.frame });
    }
    if (message.type === 'answer' && answers.has(message.id)) {
      const then = answers.get(message.id);
      answers.delete(message.id);
      then(message);
    } else hear(message, size);
  }

  function send(message) { if (socket?.readyState === WebSocket.OPEN) socket.send(JSON.stringify(message)); }

  // Says something that is answered; resolves with the answer, ok or not.
  function ask(message) {
    asked += 1;
    const id = asked;
    return new Promise((resolve) => {
      if (socket?.readyState !== WebSocket.OPEN) { resolve({ ok: false, error: 'not connected' }); return; }
      answers.set(id, resolve);
      send({ ...message, id });
    });
  }

  if (token) open(); else state('closed');
  return { send, ask };
}
