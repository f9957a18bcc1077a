/** Counts how often clips were begun and watched to the end; pure, the clock is asked elsewhere. */

export interface Counts {
  plays: number[];
  watched: number[];
}

/** Playing of some slots under one sound, from its start, round after round. */
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

  /** `position` seconds after the first start: the second to show, whether it is over, whether a count has changed. */
  at(position: number): { second: number; isOver: boolean; isNews: boolean } {
    const rounds = Math.floor(position / this.seconds);
    const isNews = rounds > this.round;
    if (isNews) {
      const ended = this.isLooped ? rounds - this.round : 1;
      for (const slot of this.slots) {
        this.counts.watched[slot]! += ended;
        if (this.isLooped) this.counts.plays[slot]! += ended;
      }
      this.round = rounds;
    }
    const isOver = !this.isLooped && rounds >= 1;
    return { second: isOver ? this.seconds : position % this.seconds, isOver, isNews };
  }

  /** Goes on after a pause: rounds are counted from the start of the sound again. */
  rewind(): void {
    this.round = 0;
  }
}
