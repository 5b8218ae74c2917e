// The frame of all pages: which rig, which page, what is wrong, who may what, and the two stops.

import { ask, command, emergencyStop, load } from "./actions.js";
import { Cells } from "./cells.js";
import { byId, el, say } from "./dom.js";
import { Events, headline, measured } from "./events.js";
import { Feed } from "./feed.js";
import { Now } from "./now.js";
import { Path } from "./path.js";
import { Rig } from "./rig.js";
import { Runs } from "./runs.js";
import { Scope } from "./scope.js";
import { clock } from "./units.js";

const PAGES = { Now, Scope, Events, Path, Cells, Runs, Rig };
const LOOK_MS = 100;
let me, feed, view, drawn = 0;

let telling;
const tell = (text) => {
  clearTimeout(telling);
  say(byId("said"), text);
  if (!/E-STOP/.test(text)) telling = setTimeout(() => say(byId("said"), ""), 15000);
};
const may = (role) => ["watch", "stop", "operate"].indexOf(me?.role) >= ["watch", "stop", "operate"].indexOf(role);

async function start() {
  const answer = await load("/me");
  if (answer.status === 200 && !answer.role) return pair();
  if (answer.status !== 200) {
    showTrouble("The page's server does not answer.");
    return setTimeout(start, 1000);
  }
  me = answer;
  const rigs = byId("rigs"), wanted = feed?.rig ?? localStorage.getItem("rig");
  rigs.replaceChildren(...me.rigs.map((name) => el("option", { value: name }, name)));
  if (me.rigs.includes(wanted)) rigs.value = wanted;
  byId("stop").disabled = byId("estop").disabled = !may("stop");
  if (!me.rigs.length) {
    showTrouble("No rig runs here: start one, hil demo.");
    return setTimeout(start, 1000);
  }
  if (feed?.rig !== rigs.value) follow(rigs.value);
}

function follow(rig) {
  feed?.close();
  localStorage.setItem("rig", rig);
  feed = new Feed(rig);
  feed.addEventListener("unpaired", () => location.reload());
  feed.addEventListener("run", () => open(location.hash.slice(1)));
  feed.addEventListener("events", () => view?.told?.());
  feed.addEventListener("cells", () => view?.injected?.());
  open(location.hash.slice(1));
}

function open(name) {
  const injects = Boolean(feed.run.cells?.length), page = PAGES[name] && (injects || name !== "Cells") ? name : "Now";
  for (const button of byId("tabs").children) {
    if (button.textContent === "Cells") button.hidden = !injects;
    button.toggleAttribute("aria-current", false);
    if (button.textContent === page) button.setAttribute("aria-current", "page");
  }
  view?.close?.();
  const main = byId("main");
  main.replaceChildren();
  view = new PAGES[page](main, feed, { tell, may });
}

function pair() {
  showTrouble("This browser is not paired.");
  if (!byId("pair").open) byId("pair").showModal();
}

byId("pair-form").addEventListener("submit", async (event) => {
  event.preventDefault();
  const answer = await ask("/pair", { code: byId("code").value, name: byId("name").value });
  if (!answer.accepted) return say(byId("pair-said"), answer.said);
  byId("pair").close();
  byId("code").value = "";
  tell(answer.said);
  start();
});
byId("pair").addEventListener("cancel", (event) => event.preventDefault());

for (const name of Object.keys(PAGES)) {
  byId("tabs").append(el("button", { type: "button", onclick: () => (location.hash = name) }, name));
}
addEventListener("hashchange", () => feed && open(location.hash.slice(1)));
byId("rigs").addEventListener("change", () => follow(byId("rigs").value));

// A press counts when the finger comes down: a stop need not wait for it to go up.
for (const [id, act] of [
  ["estop", () => emergencyStop(feed.rig, tell)],
  ["stop", () => command(feed.rig, "stop", tell)],
]) {
  let pressed = 0;
  const press = (event) => {
    if (byId(id).disabled || !feed || (event.type === "click" && performance.now() - pressed < 1000)) return;
    pressed = performance.now();
    act();
  };
  byId(id).addEventListener("pointerdown", press);
  byId(id).addEventListener("click", press); // by the keyboard
}

function showTrouble(text) {
  byId("trouble").hidden = !text;
  say(byId("trouble"), text);
}

function look() {
  if (!feed || !me) return;
  const trouble = feed.trouble();
  showTrouble(trouble.text);
  document.body.classList.toggle("old", Boolean(trouble.all));
  byId("main").classList.toggle("stale", Boolean(trouble.all) && location.hash !== "#Runs");
  byId("stop").disabled = !may("stop") || Boolean(trouble.sidecar);
  const state = byId("state");
  state.dataset.state = trouble.all ? "" : feed.state;
  say(state, trouble.all ? `was ${feed.state}` : feed.state);
  say(byId("motion"), trouble.all ? "" : feed.motion);
  const operator = feed.status.operator;
  say(byId("who"), `${me.name}, ${me.role}${operator ? `; ${operator === me.name ? "you operate" : `${operator} operates`}` : ""}`);
  showLatched();
  document.title = `${trouble.all ? "?" : feed.fault || feed.state} ${feed.rig}`;
  view?.look?.(trouble);
}

/** The latched fault, and that the tip was left inside: what was measured against which limit, its cause, and its next step as a button where that is a command. */
function showLatched() {
  const latched = feed.fault || (feed.state === "ESTOP" ? "ESTOP" : "");
  const box = byId("latched"), told = feed.status.latched;
  const event = told && told.name.toUpperCase() === latched ? told : null;
  const tip = feed.status.tip ?? "";
  const key = `${latched}|${event?.number}|${may("operate")}|${tip}`;
  if (box.dataset.key === key) return;
  box.dataset.key = key;
  box.hidden = !latched && !tip;
  const reset = el("button", { type: "button", disabled: !may("operate"), onclick: () => command(feed.rig, "reset", tell) });
  reset.append(may("operate") ? "Reset" : "Reset needs the role operate");
  const title = event ? headline(event) : latched === "ESTOP" ? "Stopped by E-STOP" : `Fault ${latched}`;
  box.replaceChildren(...(latched ? [el("p", {}, title)] : []), ...(tip ? [el("p", { className: "next" }, tip)] : []));
  if (event) {
    const when = `At ${clock(event.wall)}, ${event.run.toFixed(3)} s of the run`;
    const words = [when, measured(event), event.cause && `Cause: ${event.cause}`, `Next: ${event.action || "find out why"}`];
    box.append(...words.filter(Boolean).map((text) => el("p", { className: "next" }, text)));
  }
  if (latched) box.append(reset);
}

setInterval(look, LOOK_MS);
(function draw(now = 0) {
  requestAnimationFrame(draw);
  if (feed && now - drawn >= 38) {
    drawn = now;
    view?.draw?.();
  }
})();
addEventListener("resize", () => view?.draw?.());
start();
setInterval(() => document.hidden || start(), 5000);
