/** Keeps the frame rate up on slow machines: lowers the resolution while frames are late and raises it again later. */

const SLOW = 1 / 24; // seconds per frame
const FAST = 1 / 50;
const SMALLEST = 0.4;
const MIN_INTERVAL = 1.5; // seconds between two changes of resolution
const LONGEST = 1; // a longer gap is a hidden tab, not a slow machine

export class ResolutionControl {
  /** Fraction of the full resolution along each side. */
  scale = 1;
  private average = 1 / 60;
  private waited = 0;

  /** Call once per display frame; true when `scale` changed. */
  picture(seconds: number): boolean {
    if (seconds <= 0 || seconds > LONGEST) return false;
    this.average += (seconds - this.average) * 0.12;
    this.waited += seconds;
    if (this.waited < MIN_INTERVAL) return false;
    const next = this.average > SLOW ? this.scale * 0.75 : this.average < FAST ? this.scale * 1.15 : this.scale;
    const scale = Math.min(1, Math.max(SMALLEST, next));
    if (Math.abs(scale - this.scale) < 0.01) return false;
    this.scale = scale;
    this.waited = 0;
    return true;
  }
}
