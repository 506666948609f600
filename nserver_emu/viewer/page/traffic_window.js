// The window Traffic: what clients say and are answered, live; filtered by command or client, a row opens to its bytes.
// Rules: what is shown is text, never markup. Nothing is asked for while the window is closed.

import { element, field, button } from './parts.js';

const MOST_ROWS = 500;

export const trafficWindow = {
  id: 'traffic', title: 'Traffic', closed: true, open: false,
  build(box) {
    this.rows = [];
    this.filter = field('only', { id: 'traffic-filter', placeholder: 'vm gs -get_sn', size: 16, oninput: () => this.refill() });
    this.hold = button('Hold', () => {
      this.held = !this.held;
      this.hold.setAttribute('aria-pressed', String(this.held));
      if (!this.held) this.refill();
    }, { id: 'traffic-hold' });
    this.count = element('span', { className: 'quiet' });
    this.log = element('div', { className: 'log', tabIndex: 0 });
    this.log.setAttribute('role', 'log');
    this.log.setAttribute('aria-live', 'off');
    this.log.setAttribute('aria-label', 'Requests and replies, the latest last');
    box.append(element('div', { className: 'row' }, this.filter.label, this.hold,
      button('Clear', () => { this.rows = []; this.missed = 0; this.refill(); }), this.count), this.log);
    this.missed = 0;
  },
  toggled(open, app) { this.open = open; app.watch(); },
  hear(message) {
    if (message.type === 'missed') { this.missed += message.count; return; }
    if (message.type !== 'traffic') return;
    this.missed += message.missed;
    this.rows.push(...message.rows);
    this.rows.splice(0, this.rows.length - MOST_ROWS);
    if (!this.held) this.add(message.rows);
  },
  update() {
    this.count.textContent = `${this.rows.length} rows${this.missed ? `, ${this.missed} too fast to show` : ''}`;
  },
  add(rows) {
    const atEnd = this.log.scrollTop + this.log.clientHeight >= this.log.scrollHeight - 8;
    this.log.append(...rows.filter((row) => passes(row, this.filter.input.value)).map(rowElement));
    while (this.log.childElementCount > MOST_ROWS) this.log.firstElementChild.remove();
    if (atEnd) this.log.scrollTop = this.log.scrollHeight;
  },
  refill() { this.log.replaceChildren(); this.add(this.rows); },
};

// Words of a filter: any of them in what was said, in the command it answers or who said it; with a minus before it, none
// of them.
export function passes(row, filter) {
  const words = filter.trim().split(/\s+/).filter(Boolean), text = `${row.what} ${row.of} ${row.who}`;
  const wanted = words.filter((word) => !word.startsWith('-'));
  const unwanted = words.filter((word) => word.length > 1 && word.startsWith('-')).map((word) => word.slice(1));
  return (!wanted.length || wanted.some((word) => text.includes(word))) && !unwanted.some((word) => text.includes(word));
}

// A request part by part: `vm: code 12, translation 50, steering 0, turret 0`.
export function partsText({ what, parts }) { return `${what}: ${parts.map(([name, value]) => `${name} ${value}`).join(', ')}`; }

function rowElement(row) {
  return element('details', {},
    element('summary', {}, `${row.time_s.toFixed(3)} ${row.who} ${row.to === 'robot' ? '>' : '<'} ${row.text.slice(0, 160)}`),
    element('div', {}, row.parts?.length ? partsText(row) : row.text), element('div', {}, `${row.size} bytes: ${row.hex}`));
}
