// Commands to the server: calls to a robot, control commands, and steps that can be undone. Errors appear as a notice.

import { tenthsOf, angleTenths } from './units.js';
import { cornersError } from './geometry.js';

const MAX_STEPS = 200;

const ERRORS = { add_obstacle: 'An obstacle is not possible there: it overlaps a robot, or it reaches off the map.',
  place_robot: 'The robot does not fit there: it would overlap a wall, an obstacle or a robot.' };

// Make a call of the C library on a robot, as a client of it.
export async function callRobot(app, call, args, robot = Number(app.robot)) {
  const answer = await app.link.request({ do: 'call', robot, call, args });
  const error = answer.ok ? '' : (answer.code !== undefined && ERRORS[call]) || answer.error;
  app.notice(error);
  return answer.ok ? answer : { ...answer, error };
}

// Send a control command of the server, as `nserver ctl` does.
export async function control(app, command, argument) {
  const answer = await app.link.request({ do: 'control', command, argument });
  app.notice(answer.ok ? '' : answer.error);
  return answer;
}

// Send a control command that only reads. What a notice says stays on the page.
export async function query(app, command) {
  const answer = await app.link.request({ do: 'control', command });
  if (!answer.ok) app.notice(answer.error);
  return answer;
}

// Start or end the localizer of the selected robot.
export async function callLocalizer(app, message) {
  const answer = await app.link.request({ ...message, robot: Number(app.robot) });
  app.notice(answer.ok ? '' : answer.error);
}

// Return the undo history. A step is {title, apply, revert}; both functions send commands and resolve to the answer.
// Commands run one after another: undo waits for a step that has no answer yet. A step that can no longer be
// reverted is removed, with a notice.
export function newUndoHistory(app, onChange) {
  const done = [], undone = [];
  let last = Promise.resolve();

  function inOrder(action) {
    const result = last.then(action);
    last = result.catch(() => {});
    return result;
  }

  async function run(step) {
    const answer = await step.apply();
    if (!answer.ok) return answer;
    done.push(step);
    if (done.length > MAX_STEPS) done.shift();
    undone.length = 0;
    onChange();
    return answer;
  }

  async function move(from, to, direction, word) {
    const step = from.pop();
    if (!step) return;
    const answer = await step[direction]();
    if (answer.ok) to.push(step);
    else app.notice(`cannot ${word} “${step.title}”: ${answer.error}`);
    onChange();
  }

  return {
    run: (step) => inOrder(() => run(step)),
    undo: () => inOrder(() => move(done, undone, 'revert', 'undo')),
    redo: () => inOrder(() => move(undone, done, 'apply', 'redo')),
    get undoTitle() { return done[done.length - 1]?.title ?? null; },
    get redoTitle() { return undone[undone.length - 1]?.title ?? null; },
  };
}

export function poseTenths([x, y, steer, turret]) { return [tenthsOf(x), tenthsOf(y), angleTenths(steer), angleTenths(turret)]; }

export function placeRobot(app, id, pose) {
  const before = [...app.scene.robots[id].actual];
  return app.history.run({ title: `place robot ${id}`, apply: () => callRobot(app, 'place_robot', poseTenths(pose), Number(id)),
    revert: () => callRobot(app, 'place_robot', poseTenths(before), Number(id)) });
}

// Obstacles: each step changes one obstacle, and undo restores exactly that one; changes by others remain. If others
// changed this obstacle meanwhile, undo reports an error. `revertCommand` makes the argument from the first result.
function obstacleStep(app, title, apply, revertCommand) {
  let result = null;
  const revert = async (argument) => {
    const answer = await control(app, 'obstacle', argument);
    return answer.ok ? answer : { ...answer, error: `${answer.error} (it may have been moved or deleted meanwhile)` };
  };
  return app.history.run({ title, apply: async () => {
    const answer = await apply();
    if (answer.ok) result = answer.result ?? null;
    return answer;
  }, revert: () => revert(revertCommand(result)) });
}

// Walls, doors, walkers: each step changes one of them, as above. `wall` is that of the scene: two ends.
export function stepOn(app, command, title, change, revertChange) {
  let result = null;
  return app.history.run({ title, apply: async () => {
    const answer = await control(app, command, change);
    if (answer.ok) result = answer.result;
    return answer;
  }, revert: async () => {
    const answer = await control(app, command, revertChange(result));
    return answer.ok ? answer : { ...answer, error: `${answer.error} (it may have been moved or deleted meanwhile)` };
  } });
}

// Change walls together: all of them, or none. Each change is an argument as above.
export function changeWalls(app, title, changes) {
  const backs = [];
  const revert = async () => {
    while (backs.length) {
      const answer = await control(app, 'wall', backs[backs.length - 1]);
      if (!answer.ok) return { ...answer, error: `${answer.error} (it may have been moved or deleted meanwhile)` };
      backs.pop();
    }
    return { ok: true };
  };
  return app.history.run({ title, revert, apply: async () => {
    for (const change of changes) {
      const answer = await control(app, 'wall', change);
      if (!answer.ok) { await revert(); app.notice(answer.error); return answer; }
      const { was, is, accuracy, name } = answer.result;
      backs.push(is ? { wall: is, to: was, accuracy } : { put: was, accuracy, name });
    }
    return { ok: true };
  } });
}

export function addWall(app, ends) { return stepOn(app, 'wall', 'draw wall', { put: ends }, ({ is }) => ({ wall: is })); }

export function deleteWall(app, wall) { return stepOn(app, 'wall', 'delete wall', { wall }, ({ was, accuracy, name }) => ({ put: was, accuracy, name })); }

// An empty name removes the label.
export function labelWall(app, wall, label) {
  return stepOn(app, 'wall', 'label wall', { wall, to: wall, name: label }, ({ was, name = '' }) => ({ wall: was, to: was, name }));
}

export function moveWall(app, wall, to) { return stepOn(app, 'wall', 'move wall', { wall, to }, ({ was, is, accuracy }) => ({ wall: is, to: was, accuracy })); }

export async function addObstacle(app, corners) {
  if (corners.length === 2) return addWall(app, corners);
  const error = cornersError(corners);
  if (error) { app.notice(`Not possible: ${error}.`); return { ok: false, error }; }
  const added = corners.map((corner) => corner.map((inches) => tenthsOf(inches) / 10));
  const args = [corners.length, ...corners.flat().map(tenthsOf)];
  return obstacleStep(app, 'add obstacle', () => callRobot(app, 'add_obstacle', args), () => ({ corners: added }));
}

export function deleteObstacle(app, { corners }) {
  return obstacleStep(app, 'delete obstacle', () => control(app, 'obstacle', { corners }),
    ({ was, name, at }) => ({ put: was, name, at }));
}

export function moveObstacle(app, corners, dx_in, dy_in) {
  return obstacleStep(app, 'move obstacle', () => control(app, 'obstacle', { corners, by: [dx_in, dy_in] }),
    ({ is, was }) => ({ corners: is, to: was }));
}
