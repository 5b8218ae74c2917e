// Numbers as they came, in typed arrays of a fixed size: the newest are kept, in order and in one piece.

/** Columns of float64 that grow at their end; when the room is used up, the newest `most` move to the front. */
class Columns {
  constructor(columns, most) {
    this.most = most;
    this.length = 0;
    this.columns = Array.from({ length: columns }, () => new Float64Array(2 * most));
  }

  /** Where the next `count` rows begin. */
  room(count) {
    if (this.length + count > 2 * this.most) {
      const kept = Math.min(this.most, this.length);
      for (const column of this.columns) column.copyWithin(0, this.length - kept, this.length);
      this.length = kept;
    }
    const at = this.length;
    this.length += count;
    return at;
  }

  column(number) {
    return this.columns[number].subarray(Math.max(0, this.length - this.most), this.length);
  }
}

/** Envelopes: per turn the instant, and per signal its newest, least and largest value. */
export class History {
  constructor(signals, most) {
    this.signals = signals;
    this.rows = new Columns(1 + 2 * signals, most);
    this.newest = new Float64Array(signals).fill(NaN);
  }

  add(instant, newest, least, largest) {
    if (newest.length !== this.signals) return;
    this.newest = newest;
    const at = this.rows.room(1);
    this.rows.columns[0][at] = instant;
    for (let n = 0; n < this.signals; n++) {
      this.rows.columns[1 + n][at] = least[n];
      this.rows.columns[1 + this.signals + n][at] = largest[n];
    }
  }

  get instants() {
    return this.rows.column(0);
  }

  least(n) {
    return this.rows.column(1 + n);
  }

  largest(n) {
    return this.rows.column(1 + this.signals + n);
  }
}

/** Every tick of the chosen signals, for a minute. */
export class Ticks {
  constructor(chosen, rate) {
    this.chosen = [...chosen];
    this.rate = rate;
    this.rows = new Columns(1 + chosen.length, Math.min(Math.ceil(60 * rate), 120000));
  }

  /** numbers: the instants, then each signal's values, `count` of each. */
  add(numbers, count) {
    const at = this.rows.room(count);
    this.rows.columns.forEach((column, n) => column.set(numbers.subarray(n * count, (n + 1) * count), at));
  }

  /** Instants and values as they are now; `copy`: held while more come. */
  view(copy = false) {
    const take = (n) => (copy ? this.rows.column(n).slice() : this.rows.column(n));
    return { chosen: this.chosen, rate: this.rate, t: take(0), values: this.chosen.map((_, n) => take(n + 1)) };
  }
}

/** First place in a rising array whose value is not below. */
export function lowerBound(sorted, value) {
  let low = 0, high = sorted.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (sorted[middle] < value) low = middle + 1;
    else high = middle;
  }
  return low;
}
