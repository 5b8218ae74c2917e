// Path: where the tip went, seen from above (XY) and from the side (XZ), coloured by error.

import { el, palette, say } from "./dom.js";
import { Plot, roomy, span } from "./plot.js";
import { lowerBound } from "./store.js";
import { short } from "./units.js";

const SHOWN_S = 20;

export class Path {
  constructor(main, feed) {
    this.feed = feed;
    const linear = feed.run.axes.filter((axis) => axis.kind === "linear").map((axis) => axis.name);
    this.pairs = [[0, 1], [0, 2]].filter(([, b]) => b < linear.length).map(([a, b]) => [linear[a], linear[b]]);
    this.axes = linear.slice(0, 3);
    this.places = this.axes.map((axis) => feed.number("position", axis));
    this.errors = this.axes.map((axis) => feed.number("error", axis));
    this.note = el("p", { className: "quiet" });
    this.plots = this.pairs.map((pair) => new Plot(el("canvas", { role: "img", "aria-label": `path in ${pair.join(" and ")}` }), 360));
    main.append(this.note, el("div", { className: "split" }, ...this.plots.map((plot) => el("div", { className: "card" }, plot.canvas))));
    if (!this.pairs.length) say(this.note, "A path needs two linear axes.");
    else feed.choose([...this.places, ...this.errors]);
  }

  draw() {
    if (!this.pairs.length) return;
    const { t, values } = this.feed.ticks.view(), colours = palette();
    if (!t.length || values.length !== this.places.length + this.errors.length) return;
    const from = lowerBound(t, t[t.length - 1] - SHOWN_S), to = t.length, errors = values.slice(this.places.length);
    const worst = span(errors.map((error) => error.subarray(from).map(Math.abs)), 0, to - from)?.[1] ?? 0;
    this.pairs.forEach(([a, b], n) => this.drawPair(this.plots[n], a, b, values, from, to, worst, colours));
    const words = worst ? `colour: error, blue 0, red ${short(worst, "m")}` : "no setpoint is followed";
    say(this.note, `the last ${SHOWN_S} s, every tick · ${words}`);
  }

  drawPair(plot, a, b, values, from, to, worst, colours) {
    const xs = values[this.axes.indexOf(a)], ys = values[this.axes.indexOf(b)];
    let x = roomy(span([xs], from, to) ?? [-1e-3, 1e-3]), y = roomy(span([ys], from, to) ?? [-1e-3, 1e-3]);
    const width = Math.max(plot.canvas.clientWidth - 74, 1), height = plot.height - 42;
    const scale = Math.max((x[1] - x[0]) / width, (y[1] - y[0]) / height, 1e-12); // the same on both axes: a circle is round
    const around = ([low, high], pixels) => [(low + high - scale * pixels) / 2, (low + high + scale * pixels) / 2];
    x = around(x, width);
    y = around(y, height);
    if (!plot.begin(colours, x, y, "m", "m")) return;
    const { pen } = plot, step = Math.max(1, Math.floor((to - from) / 3000));
    pen.lineWidth = 2;
    for (let n = from + step; n < to; n += step) {
      const error = Math.max(...values.slice(this.places.length).map((each) => Math.abs(each[n]) || 0));
      pen.strokeStyle = `hsl(${210 - 210 * Math.min(worst ? error / worst : 0, 1)} 85% 45%)`;
      plot.stroke(plot.px(xs[n - step]), plot.py(ys[n - step]), plot.px(xs[n]), plot.py(ys[n]));
    }
    pen.fillStyle = colours.ink;
    pen.beginPath();
    pen.arc(plot.px(xs[to - 1]), plot.py(ys[to - 1]), 4, 0, 7);
    pen.fill();
    plot.title(`${b} over ${a}`, colours.ink);
  }

  close() {
    this.feed.choose([]);
  }
}
