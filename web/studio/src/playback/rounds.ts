/** Counts how often clips were started and watched to the end. It has no clock of its own. */

export interface Counts {
  plays: number[];
  watched: number[];
}

/** Playback of some slots with one sound, from its start, possibly looped. */
export class Rounds {
  private round = 0;

  constructor(
    readonly slots: readonly number[],
    private readonly seconds: number,
    readonly isLooped: boolean,
    private readonly counts: Counts,
  ) {
    for (const slot of slots) counts.plays[slot]!++;
  }

  /** At `position` seconds after the first start: the second to show, and whether playback ended or a count changed. */
  at(position: number): { second: number; isOver: boolean; hasChanged: boolean } {
    const rounds = Math.floor(position / this.seconds);
    const hasChanged = rounds > this.round;
    if (hasChanged) {
      const ended = this.isLooped ? rounds - this.round : 1;
      for (const slot of this.slots) {
        this.counts.watched[slot]! += ended;
        if (this.isLooped) this.counts.plays[slot]! += ended;
      }
      this.round = rounds;
    }
    const isOver = !this.isLooped && rounds >= 1;
    return { second: isOver ? this.seconds : position % this.seconds, isOver, hasChanged };
  }

  /** Resumes after a pause; rounds are counted from the start of the sound again. */
  rewind(): void {
    this.round = 0;
  }
}
