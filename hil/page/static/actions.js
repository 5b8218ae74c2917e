// What this browser asks for. Nothing is sent twice by itself, except E-STOP, which does no harm twice.

const WAIT_MS = 3000;

export async function ask(path, body, method = "POST", wait = WAIT_MS) {
  const options = { method, signal: AbortSignal.timeout(wait), keepalive: method === "POST" };
  if (method === "POST") options.body = JSON.stringify(body ?? {});
  try {
    const response = await fetch(path, options);
    return { status: response.status, ...(await response.json()) };
  } catch {
    return { status: 0, accepted: false, said: "the page's server does not answer" };
  }
}

export const load = (path, wait) => ask(path, undefined, "GET", wait);

/** E-STOP: two tries, then words that nobody can take for a success. */
export async function emergencyStop(rig, tell) {
  const path = `/rigs/${encodeURIComponent(rig)}/estop`;
  tell("E-STOP sent ...");
  let answer = await ask(path);
  if (answer.status === 0) answer = await ask(path);
  if (answer.accepted) return tell(`E-STOP: ${answer.said}`);
  const fate = answer.status === 0 ? "E-STOP WAS NOT ANSWERED" : "E-STOP DID NOT STOP IT";
  tell(`${fate}: ${answer.said}. Use the stop that cuts the drives' power.`);
}

export async function command(rig, name, tell, body = {}) {
  tell(`${name} sent ...`);
  const answer = await ask(`/rigs/${encodeURIComponent(rig)}/${name}`, body);
  if (answer.status === 409 && confirm(`${answer.said}\nTake over?`)) return command(rig, name, tell, { take: true });
  tell(`${name}: ${answer.said}`);
  return answer;
}
