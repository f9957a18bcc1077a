/** Measures sync: for each display frame, the pose's sample against the sample heard when it reached the screen. */

export interface SyncSummary {
  readonly pictures: number;
  readonly mean_ms: number;
  readonly mean_abs_ms: number;
  readonly p50_ms: number;
  readonly p99_ms: number;
  readonly max_ms: number;
  readonly held: number;
}

export class SyncMeter {
  private readonly errors: Float32Array;
  private count = 0;
  private held = 0;

  constructor(private readonly sampleRate: number, capacity = 16384) {
    this.errors = new Float32Array(capacity);
  }

  /** Positive when the pose is ahead of the sound. */
  add(shown: number, heard: number, held: boolean): void {
    this.errors[this.count++ % this.errors.length] = ((shown - heard) / this.sampleRate) * 1000;
    if (held) this.held++;
  }

  get last(): number {
    return this.count ? this.errors[(this.count - 1) % this.errors.length]! : 0;
  }

  reset(): void {
    this.count = this.held = 0;
  }

  summary(): SyncSummary {
    const errors = this.errors.slice(0, Math.min(this.count, this.errors.length));
    const size = errors.map(Math.abs).sort();
    const at = (share: number) => size[Math.min(size.length - 1, Math.floor(share * size.length))] ?? 0;
    const mean = (values: Float32Array) => values.reduce((sum, x) => sum + x, 0) / (values.length || 1);
    return {
      pictures: this.count,
      mean_ms: mean(errors),
      mean_abs_ms: mean(size),
      p50_ms: at(0.5),
      p99_ms: at(0.99),
      max_ms: size.at(-1) ?? 0,
      held: this.held,
    };
  }
}
