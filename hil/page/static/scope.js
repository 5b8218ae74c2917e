// Scope: every tick of up to four signals; triggers, cursors, spectrum; a pause that loses nothing.

import { crossing, spectrum } from "./analysis.js";
import { el, palette, say } from "./dom.js";
import { Plot, roomy, span } from "./plot.js";
import { lowerBound } from "./store.js";
import { exists, short } from "./units.js";

const MOST = 4, SPANS = [0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 30];
const kept = { signals: null, span: 2, mode: "roll", edge: "rising", level: 0, before: 25, spectrum: false };

const choice = (values, chosen, change, label) =>
  el("label", {}, label, el("select", { onchange: (event) => change(event.target.value) },
    ...values.map(([value, text]) => el("option", { value, selected: String(value) === String(chosen) }, text))));

export class Scope {
  constructor(main, feed) {
    this.feed = feed;
    this.held = null; // what is shown while paused or triggered: {view, from}
    this.cursors = [];
    this.plots = [];
    const names = kept.signals ?? [feed.number("error", feed.run.axes[0]?.name)];
    this.chosen = names.filter((n) => n >= 0 && n < feed.run.signals.length);
    this.controls(main);
    this.stage = el("div");
    this.readout = el("p", { className: "quiet", role: "status" });
    main.append(this.readout, this.stage);
    this.choose();
  }

  controls(main) {
    const { signals } = this.feed.run;
    const bySignal = signals.map((signal, n) => el("button", {
      type: "button", "aria-pressed": String(this.chosen.includes(n)), onclick: (event) => this.toggle(n, event.target),
    }, `${signal.quantity} ${signal.axis}`.trim()));
    this.summary = el("summary");
    const set = (name, number) => (value) => {
      kept[name] = number ? Number(value) : value;
      if (name !== "span" || kept.mode !== "roll") this.rearm();
    };
    this.pauseButton = el("button", { type: "button", onclick: () => this.pause() }, "Pause");
    const level = el("input", { type: "number", step: "any", value: kept.level, onchange: (event) => set("level", true)(event.target.value) });
    const before = el("input", { type: "number", min: 0, max: 100, value: kept.before, onchange: (event) => set("before", true)(event.target.value) });
    this.triggers = el("span", { className: "controls" },
      choice([["rising", "rising"], ["falling", "falling"], ["either", "either"]], kept.edge, set("edge"), "edge"),
      el("label", {}, "level", level, (this.levelUnit = el("span"))), el("label", {}, "before, %", before));
    main.append(
      el("details", { className: "card" }, this.summary, el("div", { className: "chips" }, ...bySignal)),
      el("div", { className: "controls" }, this.pauseButton,
        choice(SPANS.map((s) => [s, s < 1 ? `${s * 1000} ms` : `${s} s`]), kept.span, set("span", true), "show"),
        choice([["roll", "roll"], ["auto", "auto"], ["normal", "normal"], ["single", "single"]], kept.mode, (value) => {
          kept.mode = value;
          this.rearm();
        }, "trigger"),
        this.triggers,
        el("label", {}, el("input", { type: "checkbox", checked: kept.spectrum, onchange: (event) => {
          kept.spectrum = event.target.checked;
          this.choose();
        } }), "spectrum"),
        el("button", { type: "button", onclick: () => (this.cursors = []) }, "no cursors")));
  }

  toggle(n, button) {
    const there = this.chosen.includes(n);
    if (!there && this.chosen.length === MOST) return say(this.readout, `at most ${MOST} signals`);
    this.chosen = there ? this.chosen.filter((each) => each !== n) : [...this.chosen, n];
    button.setAttribute("aria-pressed", String(!there));
    this.choose();
  }

  choose() {
    kept.signals = this.chosen;
    this.feed.choose(this.chosen);
    const names = this.chosen.map((n) => this.name(n)).join(", ");
    say(this.summary, `signals: ${names || "none; choose some"}`);
    say(this.levelUnit, this.chosen.length ? this.feed.run.signals[this.chosen[0]].unit : "");
    const height = kept.spectrum ? 190 : Math.max(130, Math.min(300, 520 / Math.max(this.chosen.length, 1)));
    this.plots = this.chosen.map((n) => new Plot(el("canvas", { role: "img", "aria-label": this.name(n) }), height));
    this.lines = kept.spectrum ? this.chosen.map((n) => new Plot(el("canvas", { role: "img", "aria-label": `spectrum of ${this.name(n)}` }), height)) : [];
    this.stage.replaceChildren(...this.plots.map((plot, n) => {
      plot.canvas.addEventListener("click", (event) => this.place(plot, event));
      return el("div", { className: kept.spectrum ? "card split" : "card" }, plot.canvas, ...(this.lines[n] ? [this.lines[n].canvas] : []));
    }));
    this.rearm();
  }

  name(n) {
    const { quantity, axis } = this.feed.run.signals[n];
    return `${quantity} ${axis}`.trim();
  }

  /** A cursor where one taps; the older of two goes. */
  place(plot, event) {
    this.cursors = [...this.cursors, plot.at(event.offsetX)].slice(-2);
  }

  /** Hold the picture, or go on. Ticks come and are kept meanwhile. */
  pause() {
    if (this.paused) return this.rearm();
    this.paused = true;
    if (!this.held) this.held = { view: this.feed.ticks.view(true), from: this.end - kept.span };
    say(this.pauseButton, "Go on");
  }

  rearm() {
    this.paused = false;
    this.held = null;
    this.since = this.end ?? -Infinity;
    this.triggers.hidden = kept.mode === "roll";
    say(this.pauseButton, "Pause");
  }

  get end() {
    const { t } = this.feed.ticks.view();
    return t.length ? t[t.length - 1] : 0;
  }

  /** A new picture, once all that follows the crossing has come. */
  trigger() {
    const view = this.feed.ticks.view(), after = kept.span * (1 - kept.before / 100);
    if (!view.values.length || !view.t.length) return;
    const from = lowerBound(view.t, this.since), to = lowerBound(view.t, this.end - after) - 1;
    const at = crossing(view.values[0], kept.level, kept.edge, from, to);
    if (at >= 0) {
      this.held = { view: this.feed.ticks.view(true), from: view.t[at] - (kept.span * kept.before) / 100 };
      this.since = view.t[at] + after;
      this.caught = performance.now();
      if (kept.mode === "single") this.pause();
    } else if (kept.mode === "auto" && performance.now() - (this.caught ?? 0) > 1000) this.held = null;
  }

  draw() {
    if (!this.paused && kept.mode !== "roll") this.trigger();
    const colours = palette(), view = this.held?.view ?? this.feed.ticks.view();
    const from = this.held?.from ?? this.end - kept.span, gap = 2.5 / view.rate;
    this.plots.forEach((plot, place) => {
      const signal = this.feed.run.signals[this.chosen[place]], values = view.values[place] ?? new Float64Array(0);
      const [first, last] = [lowerBound(view.t, from), lowerBound(view.t, from + kept.span)];
      const found = span([values], first, last), ink = colours["abcd"[place]];
      if (!plot.begin(colours, [from, from + kept.span], roomy(found ?? [-1e-6, 1e-6]), signal.unit)) return;
      plot.curve(view.t, values, values, ink, gap);
      if (exists(signal.high)) for (const limit of [signal.low, signal.high]) plot.rule(limit, colours.red, { text: "limit" });
      if (kept.mode !== "roll" && place === 0) plot.rule(kept.level, colours.ink, { text: "level" });
      this.cursors.forEach((at, n) => plot.rule(at, colours.ink, { vertical: true, text: "AB"[n] }));
      plot.title(found ? this.name(this.chosen[place]) : `${this.name(this.chosen[place])}: nothing here`, ink);
      if (this.lines[place]) this.drawSpectrum(this.lines[place], values.subarray(first, last), view.rate, signal.unit, ink, colours);
    });
    this.read(view);
  }

  drawSpectrum(plot, values, rate, unit, ink, colours) {
    const { f, amplitude } = spectrum(values, rate);
    const found = span([amplitude], 1, f.length);
    if (!plot.begin(colours, [0, rate / 2], [0, (found?.[1] ?? 1e-9) * 1.1], unit, "Hz")) return;
    plot.curve(f, amplitude, amplitude, ink, Infinity);
    const peak = found ? amplitude.indexOf(found[1], 1) : -1;
    plot.title(peak > 0 ? `largest at ${f[peak].toPrecision(3)} Hz: ${short(found[1], unit)}` : "no spectrum: ticks are missing", ink);
  }

  /** What stands at the cursors, and how the trigger does. */
  read(view) {
    const parts = [];
    const [a, b] = this.cursors;
    if (a !== undefined) {
      for (const [at, name] of [[a, "A"], [b, "B"]]) {
        if (at === undefined) continue;
        const n = Math.min(lowerBound(view.t, at), view.t.length - 1);
        parts.push(`${name} ${at.toFixed(4)} s: ${this.chosen.map((s, place) => short(view.values[place]?.[n], this.feed.run.signals[s].unit, true)).join(", ")}`);
      }
      if (b !== undefined) parts.push(`B − A ${short(b - a, "s", true)}, ${(1 / Math.abs(b - a)).toPrecision(4)} Hz`);
    } else if (kept.mode !== "roll") parts.push(this.held ? "triggered" : "waiting for the trigger");
    if (this.paused) parts.push("paused; ticks are kept meanwhile");
    if (!parts.length) parts.push("tap a plot to place a cursor");
    say(this.readout, parts.join(" · "));
  }

  close() {
    this.feed.choose([]);
  }
}
