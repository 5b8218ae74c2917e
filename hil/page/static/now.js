// Now: each axis with what it is held to.

import { el, palette, say } from "./dom.js";
import { headline } from "./events.js";
import { ALL_THE_TIME } from "./feed.js";
import { Plot, roomy, span } from "./plot.js";
import { clock, exists, place, short } from "./units.js";

const SHOWN_S = 30;

class Bar {
  constructor(name) {
    this.fill = el("i");
    this.text = el("span");
    this.limit = el("small", { className: "quiet" });
    const cell = el("div", {}, el("div", { className: "bar" }, this.fill, el("b")), this.limit);
    this.node = el("div", { className: "row" }, el("span", {}, name), cell, this.text);
  }

  /** value against plus and minus limit, from the middle out. */
  show(value, limit, unit) {
    say(this.text, short(value, unit, true));
    say(this.limit, exists(limit) ? `limit ±${short(limit, unit)}` : "");
    const share = exists(value) && limit ? Math.max(-1, Math.min(1, value / limit)) : 0;
    this.fill.style.left = "50%";
    this.fill.style.width = "50%";
    this.fill.style.transform = `scaleX(${share})`;
    this.fill.className = Math.abs(share) >= 1 ? "over" : Math.abs(share) > 0.7 ? "near" : "";
  }
}

class AxisCard {
  constructor(feed, axis, n) {
    this.feed = feed;
    this.n = n;
    this.unit = axis.kind === "linear" ? "m" : "rad";
    this.signal = Object.fromEntries(["position", "setpoint", "error", "force"].map((name) => [name, feed.number(name, axis.name)]));
    this.drive = el("small");
    this.position = el("div", { className: "figure" });
    this.travel = el("div", { className: "quiet" });
    this.setpoint = el("div", { className: "quiet" });
    this.error = new Bar("error");
    this.force = new Bar("force");
    this.canvas = el("canvas", { "aria-label": `following error of ${axis.name}, the last ${SHOWN_S} s`, role: "img" });
    this.plot = new Plot(this.canvas, 92);
    this.node = el("section", { className: "card" },
      el("h2", {}, axis.name, this.drive), this.position, this.travel, this.setpoint, this.error.node, this.force.node, this.canvas);
  }

  look() {
    const { feed, signal, unit } = this, newest = feed.history.newest, of = (n) => feed.run.signals[n];
    say(this.drive, feed.status.drives?.[this.n] ?? "");
    say(this.position, place(newest[signal.position], unit));
    const { low, high } = of(signal.position), at = newest[signal.position], beyond = at < low || at > high;
    say(this.travel, `${beyond ? "BEYOND its " : ""}travel ${short(low, unit, true)} to ${short(high, unit, true)}`);
    this.travel.classList.toggle("beyond", beyond);
    const aim = newest[signal.setpoint];
    say(this.setpoint, exists(aim) ? `setpoint ${place(aim, unit)}` : "setpoint: none is followed");
    this.error.show(newest[signal.error], of(signal.error).high, unit);
    this.force.show(newest[signal.force], of(signal.force).high, of(signal.force).unit);
  }

  draw(colours) {
    const { history, run } = this.feed, t = history.instants, n = this.signal.error;
    const end = t.length ? t[t.length - 1] : 0, low = history.least(n), high = history.largest(n);
    const seen = t.findIndex((at) => at >= end - SHOWN_S);
    const found = span([low, high], Math.max(seen, 0), t.length);
    if (!this.plot.begin(colours, [end - SHOWN_S, end], roomy(found ?? [-1e-6, 1e-6]), run.signals[n].unit)) return;
    this.plot.title(found ? "error, every tick" : "error: no setpoint is followed", colours.faint);
    this.plot.curve(t, low, high, colours.a, 0.2);
  }
}

export class Now {
  constructor(main, feed) {
    this.feed = feed;
    this.cards = feed.run.axes.map((axis, n) => new AxisCard(feed, axis, n));
    this.notes = el("div", { className: "quiet" });
    this.warned = el("a", { href: "#Events", className: "warned", hidden: true });
    main.append(this.warned, el("div", { className: "cards" }, ...this.cards.map((card) => card.node)), this.notes);
  }

  look() {
    const { feed } = this, { status, run } = feed;
    for (const card of this.cards) card.look();
    const grave = (event) => !["NOTICE", "INFO"].includes(event.severity) && ![...ALL_THE_TIME, "STATE"].includes(event.kind);
    const last = feed.events.findLast(grave);
    this.warned.hidden = !last || Boolean(feed.fault); // which stands above, with all of it
    if (last) say(this.warned, `${clock(last.wall)} ${headline(last)}: cause and next step in Events`);
    const late = status.late ? `late p99 ${short(status.late[1], "s")}, max ${short(status.late[2], "s")}` : "";
    const notes = [
      run.law && `law ${run.law}, ${run.rate} Hz`, late, status.missed && `${status.missed[0] + status.missed[1]} ticks missed`,
      status.recording === undefined ? "" : status.recording ? "recording" : "not recording", status.silent, ...(status.problems ?? []),
    ];
    say(this.notes, notes.filter(Boolean).join(" · "));
  }

  draw() {
    const colours = palette();
    for (const card of this.cards) card.draw(colours);
  }
}
