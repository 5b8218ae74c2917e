// Events: the active ones pinned above, then all, the newest first.

import { command } from "./actions.js";
import { el } from "./dom.js";
import { clock, short } from "./units.js";

const SHOWN = 200;

/** An event in a few words; its line has all of it. */
export const headline = (event) => `${event.kind.toLowerCase().replaceAll("_", " ")}: ${event.name}${event.axis ? ` on ${event.axis}` : ""}`;

/** What was measured and against which limit; empty where nothing was. */
export const measured = (event) => {
  if (event.value === null) return "";
  if (event.limit === null) return event.measured; // so or not: no limit to it
  return `${event.measured || "measured"} ${short(event.value, event.unit)}, limit ${short(event.limit, event.unit)}`;
};

export function eventNode(event, feed, { tell, may }, active = false) {
  const times = event.times > 1 ? ` (${event.times} times${event.since ? ` since ${clock(event.since)}` : ""})` : "";
  const node = el("article", { className: `event ${event.severity}` },
    el("time", {}, clock(event.wall)), el("strong", { title: event.line }, headline(event) + times));
  node.append(el("p", { className: "quiet" }, [`${event.since ? "the last at" : "at"} ${event.run.toFixed(3)} s of the run`, measured(event)].filter(Boolean).join(", ")));
  if (event.cause) node.append(el("p", {}, `Cause: ${event.cause}`));
  if (event.action && event.action !== "none") node.append(el("p", {}, `Next: ${event.action}`));
  if (active && event.button) {
    const role = event.button === "reset" ? "operate" : "stop";
    node.append(el("p", {}, el("button", {
      type: "button", disabled: !may(role), onclick: () => command(feed.rig, event.button, tell),
    }, may(role) ? event.button : `${event.button} needs the role ${role}`)));
  }
  return node;
}

export class Events {
  constructor(main, feed, tools) {
    this.feed = feed;
    this.tools = tools;
    this.pinned = el("div", { className: "pinned", hidden: true });
    this.list = el("div", { className: "card" });
    main.append(this.pinned, this.list);
    this.told();
  }

  told() {
    const newest = this.feed.events.slice(-SHOWN).reverse();
    this.list.replaceChildren(...newest.map((event) => eventNode(event, this.feed, this.tools)));
    if (!newest.length) this.list.append("No events yet.");
  }

  /** Pinned: the latched fault, and what the detectors see now. */
  look() {
    const { latched, faults } = this.feed.status;
    const key = JSON.stringify([latched?.number, this.feed.fault, faults]);
    if (key === this.key) return;
    this.key = key;
    const seen = (faults ?? []).map((name) => this.feed.events.findLast((event) => event.name === name.toLowerCase()) ?? name);
    const active = [...(latched && this.feed.fault ? [latched] : []), ...seen.filter((event) => event.number !== latched?.number)];
    this.pinned.hidden = !active.length;
    this.pinned.replaceChildren(...active.map((event) =>
      typeof event === "string" ? el("p", {}, `seen now: ${event}`) : eventNode(event, this.feed, this.tools, true)));
  }
}
