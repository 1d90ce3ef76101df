// Messages to the server. The page holds no world of its own: each answer is the state.

export async function send(name, message = {}) {
  const answer = await fetch(name, {
    method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(message),
  });
  if (!answer.ok) throw new Error(`the editor answered ${answer.status}`);
  return answer.json();
}

// One message at a time of a kind that comes often: while one is under way only the latest other one waits.
export function latest(name, take) {
  let waiting = null, busy = false, sequence = 0;
  const next = async () => {
    if (busy || waiting === null) return;
    const message = waiting;
    waiting = null;
    busy = true;
    try {
      const reply = await send(name, message);
      if (message.sequence === sequence) take(reply, message);
    } catch (error) { /* the next one may arrive */ }
    busy = false;
    next();
  };
  return {
    push(message) { waiting = { ...message, sequence: ++sequence }; next(); },
    cancel() { waiting = null; sequence += 1; },
  };
}
