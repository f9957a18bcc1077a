/**
 * Keeps pictures coming on slow machines. Edges come before pictures: what is given up, in this order, is resolution down
 * to 0.7, triangles (`DetailControl`), pictures beyond a steady 15 a second, and the backdrop, which becomes a still
 * picture, a poster. Only then the resolution falls further. It all comes back later, one thing at a time.
 */

const STEADY = 1 / 15; // seconds per frame, where more cannot be kept up
const LATE = 1.12; // of that time: pictures are missed
const HIGH = { first: 1, slow: 1 / 24, fast: 1 / 50 }; // the scale at the beginning; seconds per frame
const LOW = { first: 0.7, slow: 1 / 20, fast: 1 / 24 }; // where pixels are dear, sharp edges are worth more than pictures
const SMOOTH = 0.7; // below, edges are seen as stairs
const SMALLEST = 0.4;
const MIN_INTERVAL = 1.5; // seconds between two changes
const PATIENCE = { first: 8, most: 120 }; // seconds until more is tried; twice as many each time that it was too much
const LONGEST = 1; // a longer gap is a hidden tab, not a slow machine
const EARLY = 0.008; // half a picture of a display of 60 a second

export class ResolutionControl {
  /** Fraction of the full resolution along each side. */
  scale: number;
  /** Whether 15 pictures a second are drawn, and no more. */
  isSteady = false;
  /** Whether the backdrop is a still picture. */
  isPoster = false;
  private average: number;
  private waited = 0;
  private patience = PATIENCE.first;
  private readonly bounds: typeof HIGH;

  constructor(low: boolean) {
    this.bounds = low ? LOW : HIGH;
    this.scale = this.bounds.first;
    this.average = this.bounds.fast;
  }

  /** Whether it is time for a picture, so many seconds after the last. */
  isDue(seconds: number): boolean {
    return !this.isSteady || seconds > STEADY - EARLY;
  }

  /** Call once per picture, with the seconds since the last; true when `scale` changed. `isCheapest`: no cheaper avatar is left. */
  picture(seconds: number, isCheapest = true): boolean {
    if (seconds <= 0 || seconds > LONGEST) return false;
    this.average += (seconds - this.average) * 0.12;
    this.waited += seconds;
    if (this.waited < MIN_INTERVAL) return false;
    const before = this.scale;
    const hasChanged = this.isSteady ? this.save() : this.adapt(isCheapest);
    if (hasChanged) this.waited = 0;
    return this.scale !== before;
  }

  private adapt(isCheapest: boolean): boolean {
    const { average, scale, bounds: { slow, fast } } = this;
    if (average > slow && scale > SMOOTH) this.scale = Math.max(SMOOTH, scale * 0.75);
    else if (average > slow && isCheapest) [this.isSteady, this.average] = [true, STEADY];
    else if (average < fast && scale < 1) this.scale = Math.min(1, scale * 1.15);
    else return false;
    return true;
  }

  private save(): boolean {
    const { average, scale, waited, patience } = this;
    if (average > LATE * STEADY) {
      if (this.isPoster) this.scale = Math.max(SMALLEST, scale * 0.75);
      this.isPoster = true;
      this.patience = Math.min(PATIENCE.most, 2 * patience);
    } else if (waited < patience) return false;
    else if (scale < SMOOTH) this.scale = Math.min(SMOOTH, scale * 1.15);
    else if (this.isPoster) this.isPoster = false;
    else [this.isSteady, this.average, this.patience] = [false, this.bounds.fast, Math.min(PATIENCE.most, 2 * patience)];
    return true;
  }
}
