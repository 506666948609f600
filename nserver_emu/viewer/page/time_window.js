// The window Time and faults: settings of the running server. Hidden on read-only pages.

import { element, button, field, form } from './widgets.js';
import { control, query } from './commands.js';

export const timeWindow = {
  id: 'time', title: 'Time and faults', closed: true,
  build(box, app) {
    const send = (command, argument) => control(app, command, argument);
    this.pause = button('Pause', () => send(app.scene.paused ? 'resume' : 'pause'), { id: 'pause' });
    this.step = field('by, s', { type: 'number', min: 0.001, max: 60, step: 'any', value: 0.1, ariaLabel: 'Step, seconds' });
    this.factor = field('', { type: 'number', min: 0.1, max: 999, step: 'any', value: 1, id: 'factor', onchange: () => this.change(send) });
    this.factor.label.prepend('Speed');
    this.factor.label.append('x real time');
    box.append(
      element('div', { className: 'row' }, this.pause, form(() => send('step', Number(this.step.input.value)),
        element('button', { id: 'step' }, 'Step'), this.step.label)),
      element('div', { className: 'row' }, this.factor.label, button('As fast as possible', () => send('speed', 'max'))));
    this.lockstep = element('p', { className: 'quiet', id: 'lockstep', hidden: true });
    box.append(this.lockstep);
    this.buildFaults(box, app, send);
  },
  async change(send) {
    this.isSending = true;
    await send('speed', this.factor.input.value);
    this.isSending = false;
    this.shown = null;
  },
  buildFaults(box, app, send) {
    const plan = element('textarea', { rows: 5, style: 'width:100%', spellcheck: false, id: 'faults',
      placeholder: '[[rule]]\ndo = "drop"\nevery = 10' });
    plan.setAttribute('aria-label', 'Fault plan in TOML');
    // Show the plan of the server, unless another text than `shownPlan` has been typed.
    let shownPlan = '';
    const show = async () => {
      const answer = await query(app, 'faults show');
      if (answer.ok && plan.value === shownPlan) plan.value = shownPlan = answer.result.plan;
    };
    const counts = element('output', { className: 'quiet', id: 'faults-counts' });
    const count = async () => {
      const answer = await query(app, 'faults counts');
      if (answer.ok) counts.textContent = countsText(answer.result.counts);
    };
    // Send a command that changes the plan. Text typed while the server answers stays.
    const sendPlan = async (command, argument) => {
      const before = plan.value, answer = await send(command, argument);
      if (!answer.ok) return;
      shownPlan = before;
      await show();
      await count();
    };
    box.append(element('details', { id: 'faults-part', ontoggle: (event) => { if (event.target.open) { show(); count(); } } },
      element('summary', {}, 'Fault injection'), plan, element('div', { className: 'row' },
        button('Apply', () => sendPlan('faults set', { text: plan.value, file: 'the page' }), { id: 'faults-set' }),
        button('Clear', () => sendPlan('faults clear'), { id: 'faults-clear' }),
        button('Count', count, { id: 'faults-count' })), counts));
  },
  update(app) {
    const { scene } = app;
    this.lockstep.hidden = scene.lockstep_s === null;
    this.lockstep.textContent = lockstepText(scene.lockstep_s);
    this.pause.textContent = scene.paused ? 'Resume' : 'Pause';
    if (scene.speed !== this.shown && !this.isSending && document.activeElement !== this.factor.input) {
      this.shown = scene.speed;
      this.factor.input.value = scene.speed === null ? '' : String(scene.speed);
    }
  },
};

// Explain lockstep mode, in which simulated time advances only with commands.
function lockstepText(step_s) {
  return step_s === null ? '' : `In lockstep each command advances time by ${Number((step_s * 1000).toFixed(3))} ms, also those of this page:`
    + ' driving, placing a robot, adding an obstacle. Stop and Release take no time.';
}

export function countsText(counts) {
  const rows = Object.entries(counts).flatMap(([line, rules]) => Object.entries(rules).map(([rule, tally]) =>
    `${line}, ${rule}: ${Object.entries(tally).map(([kind, count]) => `${kind} ${count}`).join(', ')}`));
  return rows.length ? rows.join('; ') : 'no faults are active';
}
