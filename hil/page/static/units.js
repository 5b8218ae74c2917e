// Numbers for people. SI comes in; prefixes and degrees of freedom are chosen here alone.

const PREFIXES = [[1, ""], [1e-3, "m"], [1e-6, "µ"], [1e-9, "n"], [1e-12, "p"]];

const COUNTED = ["ticks", "frames"]; // whole numbers, without a prefix

export const exists = (value) => value !== null && value !== undefined && Number.isFinite(value);

/** Scale and prefixed unit for values of that size. */
export function scaleOf(size, unit) {
  const small = Math.abs(size);
  const [scale, prefix] = PREFIXES.find(([least]) => small >= least) ?? PREFIXES[small ? 4 : 0];
  return { scale, unit: unit.startsWith("N") || unit === "1" ? (scale === 1 ? unit : prefix + unit) : prefix + unit };
}

/** A small quantity: three digits, sign, prefix. */
export function short(value, unit, signed = false) {
  if (!exists(value)) return "-";
  if (COUNTED.includes(unit)) return `${Number(value.toPrecision(4))} ${unit}`;
  if (value === 0) return `0 ${unit}`;
  const found = scaleOf(value, unit);
  const text = (value / found.scale).toPrecision(3);
  return `${signed && value > 0 ? "+" : ""}${text.replace("-", "−")} ${found.unit}`;
}

/** A position: thousandths, to the nanometre. */
export function place(value, unit) {
  return exists(value) ? `${value < 0 ? "−" : "+"}${Math.abs(value * 1e3).toFixed(6)} m${unit}` : "-";
}

export const seconds = (value) => (value < 120 ? `${value.toFixed(1)} s` : `${(value / 60).toFixed(0)} min`);

export const clock = (wall) => new Date(wall * 1000).toLocaleTimeString([], { hour12: false });
