// What the owner of the daemon asks of it as `nserver ctl` does; what was refused stands in the notice.

export async function control(app, command, argument) {
  const answer = await app.link.ask({ do: 'control', command, argument });
  app.notice(answer.ok ? '' : answer.error);
  return answer;
}
