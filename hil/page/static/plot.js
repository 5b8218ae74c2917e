// A canvas plot of our own: at each column of pixels the least and the largest value, so that no tick is left out.

import { lowerBound } from "./store.js";
import { scaleOf } from "./units.js";

const LEFT = 64, BOTTOM = 22, TOP = 20, RIGHT = 10;

/** Round distances between lines, about `count` of them. */
export function steps(low, high, count) {
  const raw = (high - low) / Math.max(count, 1);
  if (!(raw > 0)) return [low];
  const power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].find((n) => n * power >= raw) * power;
  const lines = [];
  for (let n = Math.ceil(low / step - 1e-9); n * step <= high + step * 1e-9; n++) lines.push(n * step);
  return lines;
}

/** Least and largest of values between two places, NaN left out; undefined where there is none. */
export function span(arrays, from, to) {
  let low = Infinity, high = -Infinity;
  for (const values of arrays) {
    for (let n = from; n < to; n++) {
      const value = values[n];
      if (value < low) low = value;
      if (value > high) high = value;
    }
  }
  return low <= high ? [low, high] : undefined;
}

/** A range with air around it, and never of no height. */
export function roomy([low, high]) {
  const air = (high - low) * 0.08 || Math.abs(high) * 0.1 || 1e-9;
  return [low - air, high + air];
}

export class Plot {
  constructor(canvas, height) {
    this.canvas = canvas;
    this.height = height;
    canvas.style.height = `${height}px`;
  }

  /** Begin a picture: x and y ranges in SI. Returns false where it is not seen. */
  begin(colours, x, y, unit, xUnit = "s") {
    const width = this.canvas.clientWidth, ratio = Math.min(devicePixelRatio || 1, 3);
    if (!width) return false;
    if (this.canvas.width !== Math.round(width * ratio) || this.canvas.height !== Math.round(this.height * ratio)) {
      this.canvas.width = Math.round(width * ratio);
      this.canvas.height = Math.round(this.height * ratio);
    }
    Object.assign(this, { x, y, colours, width, pen: this.canvas.getContext("2d") });
    this.pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    this.pen.clearRect(0, 0, width, this.height);
    this.pen.font = "12px system-ui, 'DejaVu Sans', sans-serif";
    this.axes(unit, xUnit);
    return true;
  }

  px(value) {
    return LEFT + ((value - this.x[0]) / (this.x[1] - this.x[0])) * (this.width - LEFT - RIGHT);
  }

  py(value) {
    return TOP + ((this.y[1] - value) / (this.y[1] - this.y[0])) * (this.height - TOP - BOTTOM);
  }

  /** The x value under a pixel of the canvas. */
  at(pixel) {
    return this.x[0] + ((pixel - LEFT) / (this.width - LEFT - RIGHT)) * (this.x[1] - this.x[0]);
  }

  axes(unit, xUnit) {
    const { pen, colours } = this;
    const shown = scaleOf(Math.max(Math.abs(this.y[0]), Math.abs(this.y[1])), unit);
    const xs = xUnit === "s" ? { scale: 1, unit: "s" } : scaleOf(Math.max(Math.abs(this.x[0]), Math.abs(this.x[1])), xUnit);
    pen.strokeStyle = colours.rule;
    pen.fillStyle = colours.faint;
    pen.lineWidth = 1;
    const lines = steps(this.y[0], this.y[1], (this.height - TOP - BOTTOM) / 34);
    const step = lines.length > 1 ? (lines[1] - lines[0]) / shown.scale : 1;
    const digits = Math.min(Math.max(0, -Math.floor(Math.log10(step) + 1e-9)), 6);
    pen.textAlign = "right";
    pen.textBaseline = "middle";
    for (const value of lines) {
      this.stroke(LEFT, this.py(value), this.width - RIGHT, this.py(value));
      pen.fillText((value / shown.scale).toFixed(digits).replace("-", "−"), LEFT - 6, this.py(value));
    }
    pen.textAlign = "center";
    pen.textBaseline = "top";
    const places = steps(this.x[0], this.x[1], (this.width - LEFT) / 90);
    const apart = places.length > 1 ? (places[1] - places[0]) / xs.scale : 1;
    const xDigits = Math.min(Math.max(0, -Math.floor(Math.log10(apart) + 1e-9)), 6);
    places.forEach((value, n) => {
      this.stroke(this.px(value), TOP, this.px(value), this.height - BOTTOM);
      const last = n === places.length - 1 ? ` ${xs.unit}` : "";
      pen.fillText((value / xs.scale).toFixed(xDigits).replace("-", "−") + last, Math.min(this.px(value), this.width - 26), this.height - BOTTOM + 5);
    });
    pen.textAlign = "left";
    pen.fillText(shown.unit, LEFT, 3);
  }

  stroke(x0, y0, x1, y1) {
    const { pen } = this;
    pen.beginPath();
    pen.moveTo(x0, y0);
    pen.lineTo(x1, y1);
    pen.stroke();
  }

  /** A title at the upper right. */
  title(text, colour) {
    this.pen.fillStyle = colour;
    this.pen.textAlign = "right";
    this.pen.textBaseline = "top";
    this.pen.fillText(text, this.width - RIGHT, 3);
  }

  /** A curve. low, high: the same array for ticks, an envelope's two otherwise. gap: s that make two curves of one. */
  curve(t, low, high, colour, gap) {
    const { pen } = this;
    let from = Math.max(lowerBound(t, this.x[0]) - 1, 0);
    const to = Math.min(lowerBound(t, this.x[1]) + 1, t.length);
    pen.save();
    pen.beginPath();
    pen.rect(LEFT, 0, this.width - LEFT - RIGHT, this.height - BOTTOM);
    pen.clip();
    pen.strokeStyle = colour;
    pen.lineWidth = 1.5;
    pen.beginPath();
    let open = false, before = -Infinity;
    while (from < to) {
      const column = Math.floor(this.px(t[from]));
      let least = Infinity, largest = -Infinity, end = from;
      while (end < to && Math.floor(this.px(t[end])) === column && !(end > from && t[end] - t[end - 1] > gap)) {
        if (low[end] < least) least = low[end];
        if (high[end] > largest) largest = high[end];
        end++;
      }
      if (least > largest) open = false;
      else {
        if (!open || t[from] - before > gap) pen.moveTo(this.px(t[from]), this.py(largest));
        else pen.lineTo(this.px(t[from]), this.py(low === high ? low[from] : largest));
        if (end - from > 1 || low !== high) {
          pen.lineTo(column + 0.5, this.py(largest));
          pen.lineTo(column + 0.5, this.py(least));
          if (low === high) pen.lineTo(this.px(t[end - 1]), this.py(low[end - 1]));
        }
        open = true;
      }
      before = t[end - 1];
      from = end;
    }
    pen.stroke();
    pen.restore();
  }

  /** A line across: a limit, a level, a cursor. */
  rule(where, colour, { vertical = false, text = "" } = {}) {
    const { pen } = this;
    const [low, high] = vertical ? this.x : this.y;
    if (!(where >= low && where <= high)) return;
    pen.strokeStyle = pen.fillStyle = colour;
    pen.lineWidth = 1;
    pen.setLineDash([5, 4]);
    if (vertical) this.stroke(this.px(where), TOP, this.px(where), this.height - BOTTOM);
    else this.stroke(LEFT, this.py(where), this.width - RIGHT, this.py(where));
    pen.setLineDash([]);
    pen.textAlign = "left";
    pen.textBaseline = "top";
    if (text) pen.fillText(text, (vertical ? this.px(where) : LEFT) + 4, vertical ? TOP + 2 : this.py(where) + 2);
  }
}
