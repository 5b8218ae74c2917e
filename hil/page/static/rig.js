// Rig: what its axes are held to, how stable its loop is, what its drives say, what its bus carries, what its computer grants.

import { load } from "./actions.js";
import { el, say } from "./dom.js";
import { exists, short } from "./units.js";

const table = (heads, rows) => el("div", { className: "wide" }, el("table", {},
  el("thead", {}, el("tr", {}, ...heads.map((head) => el("th", {}, head)))),
  el("tbody", {}, ...rows.map((row) => el("tr", {}, ...row.map((cell) => el("td", {}, cell)))))));

const MARGINS_MS = 130000; // seconds of work, at the lowest priority

const card = (title, ...children) => el("section", { className: "card" }, el("h2", {}, title), ...children);

export class Rig {
  constructor(main, feed) {
    this.feed = feed;
    this.main = main;
    this.drives = el("p");
    this.counters = el("p");
    this.margins = card("Margins", el("p", { className: "quiet" }, "being computed ..."));
    this.computer = card("Computer", el("p", { className: "quiet" }, "being looked at ..."));
    this.read();
  }

  async read() {
    const facts = await load(`/rigs/${encodeURIComponent(this.feed.rig)}/facts`);
    if (!facts.axes) return this.main.replaceChildren(facts.said ?? "No control process has left word of this rig.");
    const limits = facts.axes.map((axis) => {
      const unit = axis.kind === "linear" ? "m" : "rad", force = axis.kind === "linear" ? "N" : "N m";
      return [axis.name, `${short(axis.position[0], unit, true)} to ${short(axis.position[1], unit, true)}`, short(axis.speed, `${unit}/s`),
        short(axis.force, force), short(axis.following_error, unit)];
    });
    const { bus, load: traffic } = facts;
    const rate = [bus.bitrate, bus.data_bitrate].filter(Boolean).map((bits) => `${bits / 1e6} Mbit/s`).join(" and ");
    const carried = traffic
      ? [el("p", {}, `worst-case load ${(traffic.share * 100).toFixed(1)} %; a tick's frames take ${short(traffic.tick, "s")}; ${traffic.fits ? "all frames meet their deadlines" : "NOT all frames meet their deadlines"}`),
        table(["frame", "ends at the latest", "in time"], traffic.frames.map((each) => [each.frame, short(each.worst, "s"), each.fits ? "yes" : "NO"]))]
      : [el("p", {}, facts.problem)];
    this.main.replaceChildren(
      el("div", { className: "cards" },
        card("Rig", el("p", {}, `${this.feed.rig}: law ${facts.law}, ${facts.rate} Hz, ${bus.protocol} on ${bus.interface} ${bus.channel ?? ""}, ${rate}`),
          el("p", { className: "quiet" }, `hil ${facts.version}, rig hash ${facts.hash.slice(0, 12)}; ${facts.realtime}`)),
        card("Drives", this.drives), card("Frames", this.counters)),
      card("Limits", table(["axis", "travel", "speed", "force", "following error"], limits)),
      this.margins, card("Bus", ...carried), this.computer);
    this.look();
    this.readMargins();
    this.readComputer(facts.realtime);
  }

  /** The nominal loop of each axis, and its worst corner. */
  async readMargins() {
    const { rows, problem, said } = await load(`/rigs/${encodeURIComponent(this.feed.rig)}/margins`, MARGINS_MS);
    const number = (value, unit) => (exists(value) ? `${value.toFixed(1)} ${unit}` : "-");
    const shown = (rows ?? []).map((row) => [row.axis, row.corner, row.stable ? number(row.gain_db, "dB") : "UNSTABLE",
      row.stable ? number(row.phase_deg, "°") : "", number(row.frequency_hz, "Hz"), row.lacks]);
    this.margins.replaceChildren(el("h2", {}, "Margins"), ...(rows?.length
      ? [table(["axis", "model", "gain", "phase", "at", "less than is good"], shown)] : [el("p", {}, problem || said || "none")]));
  }

  /** What hil doctor finds, but for real time, of which the control process said itself what it was granted. */
  async readComputer(realtime) {
    const { findings, said } = await load("/computer");
    const shown = (findings ?? []).map((row) => [row.topic, row.level, row.advice ? `${row.detail}. ${row.advice}` : row.detail]);
    this.computer.replaceChildren(el("h2", {}, "Computer"), ...(findings
      ? [table(["", "", ""], [["real time", "", realtime], ...shown])] : [el("p", {}, said)]));
  }

  look() {
    const { status, run } = this.feed;
    say(this.drives, run.axes.map((axis, n) => `${axis.name}: ${status.drives?.[n] ?? "-"}`).join("; "));
    if (!status.frames) return;
    const [sent, received, lost, rejected, refused] = status.frames;
    say(this.counters, `${sent} sent, ${received} received; ${lost} samples lost, ${rejected} rejected, ${refused} refused`);
  }
}
