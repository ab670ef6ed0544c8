// What came over the websocket: points of all strips on one time axis, and quantities at instants.

export const GOES_ON = 0, BEGINS = 1, ANSWERS = 2;

export function read(buffer, traces, quantities) {
  const view = new DataView(buffer);
  const kind = view.getUint8(4), number = view.getUint32(8, true), n = view.getUint32(12, true);
  const begin = view.getFloat64(16, true), bucket = view.getFloat64(24, true);
  const values = new Float32Array(buffer, 32);
  const plain = (from, to) => Array.from(values.subarray(from, to), (v) => (v === v ? v : null));
  const strips = [], instants = [];
  for (let k = 0; k < traces; k++) strips.push(plain(2 * n * k, 2 * n * (k + 1)));
  for (let k = 0; k < quantities; k++) {
    instants.push(plain(2 * n * (traces + k), 2 * n * (traces + k + 1)));
  }
  return { kind, number, n, begin, bucket, strips, instants };
}

// A stretch of time; `base` (s) is taken off all instants, so that numbers stay small.
export class Stretch {
  constructor() { this.clear(0); }

  clear(base) {
    this.base = base;
    this.t = []; this.strips = []; this.instants = [];
  }

  take(cut, keep) {
    if (cut.kind !== GOES_ON || !this.t.length) {
      this.clear(this.base || cut.begin);
      this.strips = cut.strips.map(() => []);
      this.instants = cut.instants.map(() => []);
    }
    for (let k = 0; k < cut.n; k++) {
      const begin = cut.begin - this.base + k * cut.bucket;
      this.t.push(begin + 0.25 * cut.bucket, begin + 0.75 * cut.bucket);
    }
    cut.strips.forEach((values, k) => append(this.strips[k], values));
    cut.instants.forEach((values, k) => append(this.instants[k], values));
    const excess = this.t.length - 2 * Math.ceil(keep / cut.bucket);
    if (excess > 0 && cut.kind !== ANSWERS) {
      for (const values of [this.t, ...this.strips, ...this.instants]) values.splice(0, excess);
    }
  }

  get end() { return this.t.length ? this.t[this.t.length - 1] : 0; }

  // Index of the point nearest to an instant; -1 where there is none.
  nearest(t) {
    const x = this.t;
    if (x.length < 2) return -1;
    const step = x[1] - x[0];
    if (t < x[0] - step || t > x[x.length - 1] + step) return -1;
    let low = 0, high = x.length - 1;
    while (high - low > 1) {
      const middle = (low + high) >> 1;
      if (x[middle] < t) low = middle; else high = middle;
    }
    return t - x[low] < x[high] - t ? low : high;
  }
}

function append(all, more) { for (const value of more) all.push(value); }
