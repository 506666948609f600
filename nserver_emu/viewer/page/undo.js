// What was done at the page and can be taken back: steps {title, forth, back}, both of which ask the daemon and resolve
// with its answer. A step that can no longer be taken back says why and is forgotten. One after the other: who presses
// undo before the last step was answered for takes back that step, not the one before it.

const MOST_STEPS = 200;

export function newUndo(app, changed) {
  const done = [], undone = [];
  let last = Promise.resolve();

  function inTurn(act) {
    const through = last.then(act);
    last = through.catch(() => {});
    return through;
  }

  async function run(step) {
    const answer = await step.forth();
    if (!answer.ok) return answer;
    done.push(step);
    if (done.length > MOST_STEPS) done.shift();
    undone.length = 0;
    changed();
    return answer;
  }

  async function turn(from, to, way, word) {
    const step = from.pop();
    if (!step) return;
    const answer = await step[way]();
    if (answer.ok) to.push(step);
    else app.notice(`cannot ${word} “${step.title}”: ${answer.error}`);
    changed();
  }

  return {
    run: (step) => inTurn(() => run(step)),
    undo: () => inTurn(() => turn(done, undone, 'back', 'undo')),
    redo: () => inTurn(() => turn(undone, done, 'forth', 'redo')),
    get next() { return done[done.length - 1]?.title ?? null; },
    get again() { return undone[undone.length - 1]?.title ?? null; },
  };
}
