/** Keeps the frame rate up on slow machines: lowers the resolution while frames are late and raises it again later. */

const HIGH = { first: 1, slow: 1 / 24, fast: 1 / 50 }; // the scale at the beginning; seconds per frame
const LOW = { first: 0.5, slow: 1 / 15, fast: 1 / 24 }; // where pixels are dear, a sharper face is worth more than pictures
const SMALLEST = 0.4;
const MIN_INTERVAL = 1.5; // seconds between two changes of resolution
const LONGEST = 1; // a longer gap is a hidden tab, not a slow machine

export class ResolutionControl {
  /** Fraction of the full resolution along each side. */
  scale: number;
  private average: number;
  private waited = 0;
  private readonly bounds: typeof HIGH;

  constructor(low: boolean) {
    this.bounds = low ? LOW : HIGH;
    this.scale = this.bounds.first;
    this.average = this.bounds.fast;
  }

  /** Call once per display frame; true when `scale` changed. */
  picture(seconds: number): boolean {
    if (seconds <= 0 || seconds > LONGEST) return false;
    this.average += (seconds - this.average) * 0.12;
    this.waited += seconds;
    if (this.waited < MIN_INTERVAL) return false;
    const { slow, fast } = this.bounds;
    const next = this.average > slow ? this.scale * 0.75 : this.average < fast ? this.scale * 1.15 : this.scale;
    const scale = Math.min(1, Math.max(SMALLEST, next));
    if (Math.abs(scale - this.scale) < 0.01) return false;
    this.scale = scale;
    this.waited = 0;
    return true;
  }
}
