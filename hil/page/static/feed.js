// One rig's stream: hil/page/frames.py says what the binary messages are.

import { History, Ticks } from "./store.js";

const HEADER = 12;
const AGAIN_MS = 500;
const KEPT = 500;
export const ALL_THE_TIME = ["TICK_LATE", "TICKS_LOST"]; // on a busy machine in every second
export const STALE_S = 0.5;
const FATES = ["is not running", "", "ended", "was killed"];

export class Feed extends EventTarget {
  constructor(rig) {
    super();
    this.rig = rig;
    this.run = { axes: [], signals: [], states: {}, faults: {}, motions: {}, cells: [] };
    this.status = {};
    this.events = [];
    this.cells = new Map();
    this.pulse = { state: -1, fault: 0, motion: 0, tickAge: NaN, fate: 0, wordAge: NaN };
    this.heard = 0;
    this.began = performance.now();
    this.history = new History(0, 1500);
    this.ticks = new Ticks([], 1);
    this.open();
  }

  open() {
    const scheme = location.protocol === "https:" ? "wss" : "ws";
    this.socket = new WebSocket(`${scheme}://${location.host}/rigs/${encodeURIComponent(this.rig)}/feed`);
    this.socket.binaryType = "arraybuffer";
    this.socket.onopen = () => this.choose(this.ticks.chosen);
    this.socket.onmessage = ({ data }) => this.take(data);
    this.socket.onclose = ({ code, reason }) => {
      if (this.closed) return;
      this.refused = reason;
      if (code === 4401) this.dispatchEvent(new Event("unpaired"));
      this.timer = setTimeout(() => this.open(), AGAIN_MS);
    };
  }

  /** Ask for every tick of these signals. */
  choose(chosen) {
    if (String(chosen) !== String(this.ticks.chosen)) this.ticks = new Ticks(chosen, this.run.rate ?? 1000);
    if (this.socket.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify({ ticks: chosen }));
  }

  take(data) {
    this.heard = performance.now();
    if (typeof data === "string") this.takeText(JSON.parse(data));
    else this.takeNumbers(new Float64Array(data));
  }

  takeText(message) {
    if (message.run) {
      if (message.run.run !== this.run.run) {
        this.history = new History(message.run.signals.length, 1500);
        this.ticks = new Ticks(this.ticks.chosen.filter((n) => n < message.run.signals.length), message.run.rate ?? 1000);
      }
      this.run = message.run;
      this.events = [];
      this.cells = new Map();
      this.dispatchEvent(new Event("run"));
    }
    if (message.status) this.status = message.status;
    if (message.cells) {
      for (const cell of message.cells) this.cells.set(cell.number, cell);
      this.dispatchEvent(new Event("cells"));
    }
    if (message.events) {
      for (const event of message.events) this.keep(event);
      this.events = this.events.slice(-KEPT);
      this.dispatchEvent(new Event("events"));
    }
  }

  /** What comes all the time is one entry, the newest, with how often it came: it hides no other. */
  keep(event) {
    const same = (other) => ["kind", "name", "axis", "cause"].every((key) => other[key] === event[key]);
    const at = ALL_THE_TIME.includes(event.kind) ? this.events.findLastIndex(same) : -1;
    const [old] = at < 0 ? [] : this.events.splice(at, 1);
    this.events.push(old ? { ...event, times: old.times + event.times, since: old.since ?? old.wall } : event);
  }

  takeNumbers(numbers) {
    const [kind, signals, first, last, ticks, lost, state, fault, motion, tickAge, fate, wordAge] = numbers;
    this.pulse = { state, fault, motion, tickAge, fate, wordAge };
    if (kind === 1) {
      const part = (n) => numbers.subarray(HEADER + n * signals, HEADER + (n + 1) * signals);
      this.history.add(last, part(0), part(1), part(2));
    } else if (kind === 2) {
      const chosen = Array.from(numbers.subarray(HEADER, HEADER + signals));
      if (String(chosen) === String(this.ticks.chosen)) this.ticks.add(numbers.subarray(HEADER + signals), ticks);
    }
    this.lost = lost;
    this.first = first;
  }

  get state() {
    return this.run.states[this.pulse.state] ?? "-";
  }

  get motion() {
    const word = this.run.motions[this.pulse.motion] ?? "NONE";
    return word === "NONE" ? "" : word.toLowerCase();
  }

  get fault() {
    const word = this.run.faults[this.pulse.fault] ?? "NONE";
    return word === "NONE" ? "" : word;
  }

  /** What is dead though it should live, in words; all: nothing shown is the present. */
  trouble() {
    const silent = (performance.now() - (this.heard || this.began)) / 1000;
    if (silent > STALE_S) {
      const why = this.refused ? ` (${this.refused})` : "";
      return { all: true, text: `No word from the page's server for ${silent.toFixed(1)} s${why}. What is shown is as old.` };
    }
    const { fate, tickAge, wordAge } = this.pulse;
    if (fate !== 1) return { all: true, text: `The control process ${FATES[fate]}. What is shown is how it was.` };
    if (tickAge > STALE_S) {
      return { all: true, text: `The control process hangs: no tick for ${tickAge.toFixed(1)} s. What is shown is as old.` };
    }
    if (!(wordAge <= STALE_S)) {
      const long = Number.isFinite(wordAge) ? ` for ${wordAge.toFixed(1)} s` : "";
      return { sidecar: true, text: `No word from the sidecar${long}: drives, events and Stop are missing. E-STOP works.` };
    }
    return { text: "" };
  }

  /** Number of a signal; -1: there is none. */
  number(quantity, axis) {
    return this.run.signals.findIndex((signal) => signal.quantity === quantity && signal.axis === axis);
  }

  close() {
    this.closed = true;
    clearTimeout(this.timer);
    this.socket.close();
  }
}
