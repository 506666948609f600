// The window Traffic: requests and replies of clients, live, filtered by command or client; a row opens to its bytes. All
// is shown as text, never as markup. The server sends nothing while the window is closed.

import { element, field, button } from './widgets.js';

const MAX_ROWS = 500;

export const trafficWindow = {
  id: 'traffic', title: 'Traffic', closed: true, open: false,
  build(box) {
    this.rows = [];
    this.filter = field('only', { id: 'traffic-filter', placeholder: 'vm gs -get_sn', size: 16, oninput: () => this.refill() });
    this.pause = button('Pause', () => {
      this.isPaused = !this.isPaused;
      this.pause.setAttribute('aria-pressed', String(this.isPaused));
      if (!this.isPaused) this.refill();
    }, { id: 'traffic-hold' });
    this.count = element('span', { className: 'quiet' });
    this.log = element('div', { className: 'log', tabIndex: 0 });
    this.log.setAttribute('role', 'log');
    this.log.setAttribute('aria-live', 'off');
    this.log.setAttribute('aria-label', 'Requests and replies, latest last');
    box.append(element('div', { className: 'row' }, this.filter.label, this.pause,
      button('Clear', () => { this.rows = []; this.missed = 0; this.refill(); }), this.count), this.log);
    this.missed = 0;
  },
  onToggle(open, app) { this.open = open; app.watch(); },
  onMessage(message) {
    if (message.type === 'missed') { this.missed += message.count; return; }
    if (message.type !== 'traffic') return;
    this.missed += message.missed;
    this.rows.push(...message.rows);
    this.rows.splice(0, this.rows.length - MAX_ROWS);
    if (!this.isPaused) this.add(message.rows);
  },
  update() {
    this.count.textContent = `${this.rows.length} rows${this.missed ? `, ${this.missed} omitted` : ''}`;
  },
  add(rows) {
    const atEnd = this.log.scrollTop + this.log.clientHeight >= this.log.scrollHeight - 8;
    this.log.append(...rows.filter((row) => passes(row, this.filter.input.value)).map(rowElement));
    while (this.log.childElementCount > MAX_ROWS) this.log.firstElementChild.remove();
    if (atEnd) this.log.scrollTop = this.log.scrollHeight;
  },
  refill() { this.log.replaceChildren(); this.add(this.rows); },
};

// Return true if a row passes the filter: it contains one of the words, and none of those with a minus sign. Searched are
// the command or reply, the command replied to, and the name of the client.
export function passes(row, filter) {
  const words = filter.trim().split(/\s+/).filter(Boolean), text = `${row.what} ${row.of} ${row.who}`;
  const wanted = words.filter((word) => !word.startsWith('-'));
  const unwanted = words.filter((word) => word.length > 1 && word.startsWith('-')).map((word) => word.slice(1));
  return (!wanted.length || wanted.some((word) => text.includes(word))) && !unwanted.some((word) => text.includes(word));
}

// Return the parts of a request: `vm: code 12, translation 50, steering 0, turret 0`.
function partsText({ what, parts }) { return `${what}: ${parts.map(([name, value]) => `${name} ${value}`).join(', ')}`; }

function rowElement(row) {
  return element('details', {},
    element('summary', {}, `${row.time_s.toFixed(3)} ${row.who} ${row.to === 'robot' ? '>' : '<'} ${row.text.slice(0, 160)}`),
    element('div', {}, row.parts?.length ? partsText(row) : row.text), element('div', {}, `${row.size} bytes: ${row.hex}`));
}
