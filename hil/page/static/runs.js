// Runs: what the folder holds, the newest first.

import { load } from "./actions.js";
import { el, say } from "./dom.js";
import { seconds, short } from "./units.js";

const HEADS = ["run", "rig", "law", "lasted", "ended", "worst RMS", "note"];

export class Runs {
  constructor(main) {
    this.body = el("tbody");
    this.words = el("p", { className: "quiet" }, "reading the runs ...");
    this.filter = el("input", { type: "search", "aria-label": "only runs with this word", placeholder: "only with this word", oninput: () => this.show() });
    main.append(el("div", { className: "controls" }, this.filter), this.words,
      el("div", { className: "card wide" }, el("table", {}, el("thead", {}, el("tr", {}, ...HEADS.map((head) => el("th", {}, head)))), this.body)));
    this.read();
  }

  async read() {
    const answer = await load("/runs");
    if (!answer.runs) return say(this.words, answer.said);
    this.runs = answer.runs;
    this.folder = answer.folder;
    this.show();
  }

  show() {
    const word = this.filter.value.toLowerCase();
    const rows = (this.runs ?? []).map((run) => [
      run.run, run.rig, run.law, run.seconds ? seconds(run.seconds) : "-", run.ended,
      run.axis ? `${run.axis} ${short(run.error, run.kind === "linear" ? "m" : "rad")}` : "-", [run.lacks, run.note].filter(Boolean).join(", "),
    ]).filter((row) => row.join(" ").toLowerCase().includes(word));
    this.body.replaceChildren(...rows.map((row) => el("tr", {}, ...row.map((cell) => el("td", {}, cell)))));
    say(this.words, `${rows.length} of ${this.runs?.length ?? 0} runs in ${this.folder}/`);
  }
}
