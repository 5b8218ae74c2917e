// Triggers and spectra: numbers in, numbers out.

/** Place of the newest tick in (from, to] at which the values cross `level`; -1: none. edge: rising, falling, either. */
export function crossing(values, level, edge, from, to) {
  for (let n = Math.min(to, values.length - 1); n > Math.max(from, 0); n--) {
    const up = values[n - 1] < level && values[n] >= level, down = values[n - 1] > level && values[n] <= level;
    if ((up && edge !== "falling") || (down && edge !== "rising")) return n;
  }
  return -1;
}

/** In place, decimation in time; re and im have a length that is a power of two. */
function transform(re, im) {
  const size = re.length;
  for (let n = 1, reversed = 0; n < size; n++) {
    let bit = size >> 1;
    for (; reversed & bit; bit >>= 1) reversed ^= bit;
    reversed ^= bit;
    if (n < reversed) {
      [re[n], re[reversed]] = [re[reversed], re[n]];
      [im[n], im[reversed]] = [im[reversed], im[n]];
    }
  }
  for (let length = 2; length <= size; length <<= 1) {
    const angle = (-2 * Math.PI) / length;
    for (let k = 0; k < length / 2; k++) {
      const c = Math.cos(angle * k), s = Math.sin(angle * k);
      for (let at = k; at < size; at += length) {
        const other = at + length / 2;
        const r = re[other] * c - im[other] * s, i = re[other] * s + im[other] * c;
        re[other] = re[at] - r;
        im[other] = im[at] - i;
        re[at] += r;
        im[at] += i;
      }
    }
  }
}

/** Amplitudes of the newest 2^n values at most `values` long, mean taken away, Hann's window: a sine of amplitude A
 *  shows as A. Empty where a value is missing among them. rate: values a second, Hz. */
export function spectrum(values, rate) {
  const size = 2 ** Math.floor(Math.log2(Math.max(values.length, 1)));
  if (size < 16) return { f: new Float64Array(0), amplitude: new Float64Array(0) };
  const re = Float64Array.from(values.subarray(values.length - size)), im = new Float64Array(size);
  const mean = re.reduce((sum, value) => sum + value, 0) / size;
  if (!Number.isFinite(mean)) return { f: new Float64Array(0), amplitude: new Float64Array(0) };
  for (let n = 0; n < size; n++) re[n] = (re[n] - mean) * (1 - Math.cos((2 * Math.PI * n) / size));
  transform(re, im);
  const f = new Float64Array(size / 2), amplitude = new Float64Array(size / 2);
  for (let n = 0; n < size / 2; n++) {
    f[n] = (n * rate) / size;
    amplitude[n] = (2 * Math.hypot(re[n], im[n])) / size;
  }
  return { f, amplitude };
}
