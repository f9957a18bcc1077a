/** Keeps the picture fluent on weak machines: gives up resolution while pictures come late, takes it back when they do not. */

const SLOW = 1 / 24; // seconds a picture
const FAST = 1 / 50;
const SMALLEST = 0.4;
const PATIENCE = 1.5; // seconds between two changes
const LONGEST = 1; // a longer gap is a hidden tab, not a slow machine

export class Governor {
  /** Share of the full resolution, along each side. */
  scale = 1;
  private average = 1 / 60;
  private waited = 0;

  /** Once a picture; true when `scale` changed. */
  picture(seconds: number): boolean {
    if (seconds <= 0 || seconds > LONGEST) return false;
    this.average += (seconds - this.average) * 0.12;
    this.waited += seconds;
    if (this.waited < PATIENCE) return false;
    const next = this.average > SLOW ? this.scale * 0.75 : this.average < FAST ? this.scale * 1.15 : this.scale;
    const scale = Math.min(1, Math.max(SMALLEST, next));
    if (Math.abs(scale - this.scale) < 0.01) return false;
    this.scale = scale;
    this.waited = 0;
    return true;
  }
}
