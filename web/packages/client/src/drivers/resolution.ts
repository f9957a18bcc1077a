/**
 * Keeps the frame rate up on slow machines: lowers the resolution while frames are late and raises it again later. Edges
 * come before pictures: the scale stays at 0.7 as long as 15 pictures a second are drawn or a cheaper avatar is left.
 */

const SLOWEST = 1 / 15; // seconds per frame from which the scale falls below SMOOTH, where nothing else can be given up
const HIGH = { first: 1, slow: 1 / 24, fast: 1 / 50 }; // the scale at the beginning; seconds per frame
const LOW = { first: 0.7, slow: SLOWEST, fast: 1 / 24 }; // where pixels are dear, sharp edges are worth more than pictures
const SMOOTH = 0.7; // below, edges are seen as stairs
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

  /** Call once per display frame; true when `scale` changed. `isCheapest`: no cheaper avatar is left. */
  picture(seconds: number, isCheapest = true): boolean {
    if (seconds <= 0 || seconds > LONGEST) return false;
    this.average += (seconds - this.average) * 0.12;
    this.waited += seconds;
    if (this.waited < MIN_INTERVAL) return false;
    const { slow, fast } = this.bounds;
    const least = isCheapest && this.average > SLOWEST ? SMALLEST : Math.min(SMOOTH, this.scale);
    const next = this.average > slow ? Math.max(least, this.scale * 0.75) : this.average < fast ? this.scale * 1.15 : this.scale;
    const scale = Math.min(1, next);
    if (Math.abs(scale - this.scale) < 0.01) return false;
    this.scale = scale;
    this.waited = 0;
    return true;
  }
}
