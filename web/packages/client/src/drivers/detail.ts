/** Which level of detail is shown: it starts with the coarsest, which comes first, and follows the measured frame time. */

const QUICK = 1 / 45; // seconds per frame
const SLOW = 1 / 28;
const SETTLED_S = 2; // a level is judged after so long
const LONGEST = 1; // a longer gap is a hidden tab, not a slow machine
export const COARSEST = 2;

export class DetailControl {
  /** The level to show: 0 is the finest. */
  level = COARSEST;
  /** Whether no coarser level is left. */
  get isCheapest(): boolean {
    return this.level === COARSEST;
  }

  private finest = 0;
  private average = 1 / 30;
  private waited = 0;

  /** With `isFixed` the coarsest level stays, as where WebGL runs on the processor. */
  constructor(private readonly isFixed: boolean) {}

  /** Call once per display frame; true when `level` changed. A level that was too slow is not tried again. */
  picture(seconds: number): boolean {
    if (this.isFixed || seconds <= 0 || seconds > LONGEST) return false;
    this.average += (seconds - this.average) * 0.05;
    this.waited += seconds;
    if (this.waited < SETTLED_S) return false;
    const isSlow = this.average > SLOW && this.level < COARSEST;
    if (isSlow) this.finest = this.level + 1;
    const next = isSlow ? this.level + 1 : this.average < QUICK ? this.finest : this.level;
    if (next === this.level) return false;
    this.level = next;
    this.restart();
    return true;
  }

  /** Judge anew, as after a swap has taken place. */
  restart(): void {
    this.waited = 0;
  }
}
