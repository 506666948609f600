// Robots that are held: said above everything, whoever stopped them and however little may be done here, with the button
// that releases them. What a screen reader is told is who is held; what is counted changes too often for that.

// Who is held, and how often they were told to move since, in words; null where nobody is. `me`: this viewer's name.
export function heldWords(robots, me) {
  const all = Object.keys(robots), held = all.filter((id) => robots[id].held);
  if (!held.length) return null;
  const by = [...new Set(held.map((id) => robots[id].held.by))].map((name) => (name === me ? `you (${name})` : name));
  const ignored = held.reduce((sum, id) => sum + robots[id].held.ignored, 0);
  return {
    who: `Held: ${whatStands(held, all)} until Release. Stopped by ${by.join(' and ')}.`,
    ignored: ignored ? `${ignored} ${ignored === 1 ? 'command' : 'commands'} to move ignored.` : '',
  };
}

function whatStands(held, all) {
  if (held.length === all.length) return 'nothing moves';
  return held.length === 1 ? `robot ${held[0]} does not move` : `robots ${held.join(', ')} do not move`;
}

export function setUpHolding(app) {
  const place = document.getElementById('held'), who = document.getElementById('held-who'), count = document.getElementById('held-ignored');
  document.getElementById('release').addEventListener('click', () => release(app));
  document.addEventListener('keydown', (event) => {
    if (event.key !== 'R' || !event.shiftKey || event.repeat || event.ctrlKey || event.metaKey || event.altKey) return;
    if (place.hidden || !app.mayAct || event.target.matches?.('input, textarea, select')) return;
    event.preventDefault();
    release(app);
  });
  return () => {
    const words = heldWords(app.scene.robots, app.name);
    place.hidden = !words;
    for (const [part, text] of [[who, words?.who ?? ''], [count, words?.ignored ?? '']]) if (part.textContent !== text) part.textContent = text;
  };
}

async function release(app) {
  const answer = await app.link.ask({ do: 'release' });
  app.notice(answer.ok ? '' : `NOT RELEASED — ${answer.error}`);
}
