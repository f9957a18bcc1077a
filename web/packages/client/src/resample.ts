/** A streaming resampler: windowed sinc, one phase table, constant memory. */

const HALF = 16; // taps on each side, at the lower of the two rates
const PHASES = 512;

export class Resampler {
  private readonly table: Float32Array;
  private readonly reach: number; // input samples on each side
  private history: Float32Array;
  private position: number; // of the next output sample, in input samples from the start of the history
  private readonly step: number;

  constructor(readonly from: number, readonly to: number) {
    this.step = from / to;
    const cut = Math.min(1, to / from) * 0.95;
    this.reach = Math.ceil(HALF / cut);
    this.table = kernel(this.reach, cut);
    this.history = new Float32Array(this.reach);
    this.position = this.reach;
  }

  /** Returns the output samples that are complete; the last `reach` inputs wait for their successors. */
  push(input: Float32Array): Float32Array {
    if (this.from === this.to) return input.slice();
    const all = new Float32Array(this.history.length + input.length);
    all.set(this.history);
    all.set(input, this.history.length);
    const limit = all.length - this.reach - 1;
    const count = Math.max(0, Math.floor((limit - this.position) / this.step) + 1);
    const out = new Float32Array(count);
    for (let n = 0; n < count; n++) out[n] = this.at(all, this.position + n * this.step);
    const next = this.position + count * this.step;
    const keep = Math.max(0, Math.floor(next) - this.reach);
    this.history = all.slice(keep);
    this.position = next - keep;
    return out;
  }

  private at(all: Float32Array, where: number): number {
    const whole = Math.floor(where);
    const phase = Math.round((where - whole) * PHASES);
    const width = 2 * this.reach + 1;
    const row = phase * width;
    let sum = 0;
    for (let k = 0; k < width; k++) sum += (all[whole - this.reach + k] ?? 0) * this.table[row + k]!;
    return sum;
  }
}

/** Hann-windowed sincs, one row per phase, each normalised to sum 1. */
function kernel(reach: number, cut: number): Float32Array {
  const width = 2 * reach + 1;
  const table = new Float32Array((PHASES + 1) * width);
  for (let phase = 0; phase <= PHASES; phase++) {
    let sum = 0;
    for (let k = 0; k < width; k++) {
      const x = k - reach - phase / PHASES;
      const window = Math.abs(x) > reach ? 0 : 0.5 + 0.5 * Math.cos((Math.PI * x) / reach);
      const angle = Math.PI * x * cut;
      sum += table[phase * width + k] = window * (Math.abs(angle) < 1e-9 ? 1 : Math.sin(angle) / angle);
    }
    for (let k = 0; k < width; k++) table[phase * width + k]! /= sum;
  }
  return table;
}
