// The window Time, noise, faults: what the owner of the daemon may change of it. Shown to who may act.

import { element, button, choice, field, form } from './parts.js';
import { control } from './control.js';

export const NOISE_PARTS = { sensors: 'Sensors', motion: 'Motion' };

export const timeWindow = {
  id: 'time', title: 'Time, noise, faults', acts: true,
  build(box, app) {
    const ask = (command, argument) => control(app, command, argument);
    this.pause = button('Pause', () => ask(app.scene.paused ? 'resume' : 'pause'), { id: 'pause' });
    this.step = field('by, s', { type: 'number', min: 0.001, max: 60, step: 'any', value: 0.1, ariaLabel: 'Step, seconds' });
    this.factor = field('', { type: 'number', min: 0.1, max: 999, step: 'any', value: 1, id: 'factor', onchange: () => this.change(ask) });
    this.factor.label.prepend('Speed');
    this.factor.label.append('x real time');
    box.append(
      element('div', { className: 'row' }, this.pause, form(() => ask('step', Number(this.step.input.value)),
        element('button', { id: 'step' }, 'Step'), this.step.label)),
      element('div', { className: 'row' }, this.factor.label, button('As fast as it can', () => ask('speed', 'max'))));
    this.lockstep = element('p', { className: 'quiet', id: 'lockstep', hidden: true });
    box.append(this.lockstep);
    this.buildNoise(box, app, ask);
    this.buildFaults(box, ask);
  },
  async change(ask) {
    this.asking = true;
    await ask('speed', this.factor.input.value);
    this.asking = false;
    this.shown = null;
  },
  buildNoise(box, app, ask) {
    const all = element('input', { type: 'checkbox', id: 'noise-all' });
    const whose = () => (all.checked ? {} : { robot: Number(app.robot) });
    this.noise = Object.fromEntries(Object.entries(NOISE_PARTS).map(([name, title]) =>
      [name, choice(title, { id: `noise-${name}` }, (value) => ask('noise', { [name]: value, ...whose() }))]));
    box.append(element('div', { className: 'row', role: 'group', ariaLabel: 'Noise' }, ...Object.values(this.noise).map((one) => one.label),
      element('label', {}, all, 'all robots')));
  },
  buildFaults(box, ask) {
    const plan = element('textarea', { rows: 5, style: 'width:100%', spellcheck: false, id: 'faults',
      placeholder: '[[rule]]\ndo = "drop"\nevery = 10' });
    plan.setAttribute('aria-label', 'Plan of faults in TOML');
    const show = async () => {
      const before = plan.value, answer = await ask('faults show');
      if (answer.ok && plan.value === before) plan.value = answer.said.plan;  // what is typed meanwhile stays
    };
    const counted = element('output', { className: 'quiet', id: 'faults-counts' });
    const count = async () => {
      const answer = await ask('faults counts');
      if (answer.ok) counted.textContent = countsText(answer.said.counts);
    };
    box.append(element('details', { id: 'faults-part', ontoggle: (event) => { if (event.target.open) { show(); count(); } } },
      element('summary', {}, 'Faults on purpose'), plan, element('div', { className: 'row' },
        button('Put in force', async () => { if ((await ask('faults set', { text: plan.value, file: 'the page' })).ok) { await show(); count(); } }, { id: 'faults-set' }),
        button('Clear', async () => { if ((await ask('faults clear')).ok) { await show(); count(); } }, { id: 'faults-clear' }),
        button('Count', count, { id: 'faults-count' })), counted));
  },
  update(app) {
    const { scene } = app, body = scene.bodies[app.robot];
    this.lockstep.hidden = scene.lockstep_s === null;
    this.lockstep.textContent = lockstepText(scene.lockstep_s);
    this.pause.textContent = scene.paused ? 'Resume' : 'Pause';
    if (scene.speed !== this.shown && !this.asking && document.activeElement !== this.factor.input) {
      this.shown = scene.speed;
      this.factor.input.value = scene.speed === null ? '' : String(scene.speed);
    }
    for (const name of body ? Object.keys(NOISE_PARTS) : []) this.noise[name].offer(body.noises[name], body.noise[name]);
  },
};

// What the page's user is to know where time moves by what is asked.
export function lockstepText(step_s) {
  return step_s === null ? '' : `In lockstep each command moves time on by ${Number((step_s * 1000).toFixed(3))} ms, those of this page too:`
    + ' driving, placing a robot, adding an obstacle. Stop and Release take no time.';
}

export function countsText(counts) {
  const rows = Object.entries(counts).flatMap(([line, rules]) => Object.entries(rules).map(([rule, tally]) =>
    `${line}, ${rule}: ${Object.entries(tally).map(([kind, count]) => `${kind} ${count}`).join(', ')}`));
  return rows.length ? rows.join('; ') : 'no faults are in force';
}
