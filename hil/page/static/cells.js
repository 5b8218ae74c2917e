// Cells: the dish from above with the verdict of each cell, how many have which, and each one's numbers.

import { el, palette, say } from "./dom.js";
import { Plot, roomy, span } from "./plot.js";
import { short } from "./units.js";

const LISTED = 100;
// Hues alike are told apart by the words of table and legend.
const HUES = {
  ok: 140, "no cell": 200, rolled: 270, "not pierced": 35, double: 0, "sensor dead": 185, "camera frozen": 220, clogged: 25, stuck: 325,
  broken: 0, unknown: 210, skipped: 50, held: 95, burst: 10,
};
const DIM = ["no cell", "unknown", "skipped"];

export const colourOf = (verdict) => `hsl(${HUES[verdict] ?? 210} ${DIM.includes(verdict) ? 12 : 70}% 45%)`;

/** How many have which verdict, the most frequent first. */
export function counts(cells) {
  const found = new Map();
  for (const { verdict } of cells) if (verdict) found.set(verdict, (found.get(verdict) ?? 0) + 1);
  return [...found].sort((a, b) => b[1] - a[1]);
}

export class Cells {
  constructor(main, feed) {
    this.feed = feed;
    this.note = el("p", { role: "status" });
    this.legend = el("p", { className: "legend" });
    this.plot = new Plot(el("canvas", { role: "img", "aria-label": "the dish from above" }), 420);
    this.rows = el("tbody");
    const heads = ["cell", "verdict", "time", "puncture", "peak", "depth"].map((head) => el("th", {}, head));
    main.append(
      el("div", { className: "card" }, this.note, this.plot.canvas, this.legend),
      el("div", { className: "card wide" }, el("table", {}, el("thead", {}, el("tr", {}, ...heads)), this.rows)));
    this.injected();
  }

  /** A cell has come to something new. */
  injected() {
    const cells = [...this.feed.cells.values()].sort((a, b) => b.number - a.number), total = this.feed.run.cells.length;
    const over = cells.filter((cell) => cell.verdict), present = cells.find((cell) => cell.phase);
    const now = present ? ` · cell ${present.number}: ${present.phase}` : "";
    say(this.note, `${over.length} of ${total} cells are over${now}`);
    this.legend.replaceChildren(...counts(cells).map(([verdict, count]) => el("span", {}, this.dot(verdict), `${verdict} ${count}`)));
    this.rows.replaceChildren(...cells.slice(0, LISTED).map((cell) => el("tr", {},
      ...[cell.number, cell.verdict || cell.phase, cell.verdict ? short(cell.seconds, "s") : "-", short(cell.force, "N"), short(cell.peak, "N"),
        short(cell.depth, "m")].map((text) => el("td", {}, `${text}`)))));
  }

  dot(verdict) {
    const found = el("i", { className: "dot" });
    found.style.background = colourOf(verdict);
    return found;
  }

  draw() {
    const places = this.feed.run.cells, colours = palette();
    if (!places.length) return;
    const [xs, ys] = [0, 1].map((axis) => places.map((place) => place[axis]));
    let x = roomy(span([xs], 0, xs.length)), y = roomy(span([ys], 0, ys.length));
    const width = Math.max(this.plot.canvas.clientWidth - 74, 1), height = this.plot.height - 42;
    const scale = Math.max((x[1] - x[0]) / width, (y[1] - y[0]) / height, 1e-12);
    const around = ([low, high], pixels) => [(low + high - scale * pixels) / 2, (low + high + scale * pixels) / 2];
    x = around(x, width);
    y = around(y, height);
    if (!this.plot.begin(colours, x, y, "m", "m")) return;
    const { pen } = this.plot, radius = Math.max(3, Math.min(14, (0.35 * Math.min(width, height)) / Math.sqrt(places.length)));
    places.forEach((place, n) => {
      const cell = this.feed.cells.get(n + 1);
      pen.beginPath();
      pen.arc(this.plot.px(place[0]), this.plot.py(place[1]), radius, 0, 7);
      pen.lineWidth = cell?.phase ? 3 : 1;
      pen.strokeStyle = cell?.phase ? colours.ink : colours.faint;
      if (cell?.verdict) {
        pen.fillStyle = colourOf(cell.verdict);
        pen.fill();
      }
      pen.stroke();
    });
  }
}
