/** Plays a task's clips in their views, in sync with the sound that is heard. */

import type { Pose } from "@echoavatar/client";
import type { Media } from "./media.js";
import { type Counts, Rounds } from "./rounds.js";
import { Sound } from "./sound.js";
import type { Views } from "./views.js";

const SLOWEST_PICTURE = 120; // ms; upper bound of the predicted delay until a display frame is on screen
const STUCK_MS = 4000;
const WEAK_MS = 60; // minimum frame time with software rendering, so that sound and input get processor time

interface ClipView {
  readonly element: HTMLElement;
  readonly pose: Pose;
  second: number;
  covered: boolean;
  dirty: boolean;
}

export class ClipPlayer {
  readonly sound = new Sound();
  private media: Media | null = null;
  private clipViews: ClipView[] = [];
  private seconds = 1;
  private counts: Counts = { plays: [], watched: [] };
  private rounds: Rounds | null = null;
  private paused: number | null = null; // second of the sound at which playback was paused
  private readonly sizes = new ResizeObserver(() => this.fit());
  private last = 0;
  private interval = 16;
  private moving = { position: -1, since: 0 };
  /** Called when playback starts, pauses, ends or loops. */
  onChange: (() => void) | null = null;
  /** Called with the progress, 0 to 1, for every display frame while playing. */
  onTime: ((share: number) => void) | null = null;
  /** Called when clips that are not looped have ended. */
  onEnd: ((slots: readonly number[]) => void) | null = null;
  /** Called when the sound does not advance although it should. */
  onStuck: (() => void) | null = null;

  constructor(private readonly views: Views) {
    views.camera.onMove = () => this.redraw();
    document.addEventListener("visibilitychange", () => document.hidden && this.pause());
    const draw = (now: number) => {
      requestAnimationFrame(draw);
      if (!views.low || now - this.last >= WEAK_MS) this.picture(now);
    };
    requestAnimationFrame(draw);
  }

  /** Shows the first frame of each clip in its element; `host` contains all elements and the canvas. */
  set(host: HTMLElement, elements: readonly HTMLElement[], media: Media, seconds: number, counts: Counts): void {
    this.stop();
    host.append(this.views.canvas);
    this.clipViews = elements.map((element, slot) => {
      return { element, pose: media.clips[slot]!.blank(), second: 0, covered: false, dirty: true };
    });
    [this.media, this.seconds, this.counts] = [media, seconds, counts];
    this.views.camera.attach(elements);
    this.views.camera.reset();
    this.sizes.disconnect();
    for (const element of [host, ...elements]) this.sizes.observe(element);
    this.fit();
  }

  /** Slots that play or are paused; null if none was started or playback has ended. */
  get slots(): readonly number[] | null {
    return this.rounds?.slots ?? null;
  }

  get isPlaying(): boolean {
    return this.rounds !== null && this.paused === null;
  }

  /** Plays the slots together from the start. Call it from a click or a key. */
  async play(slots: readonly number[], isLooped: boolean): Promise<void> {
    if (!this.media) return;
    this.rounds = new Rounds(slots, this.seconds, isLooped, this.counts);
    this.paused = null;
    this.moving = { position: -1, since: performance.now() };
    this.onChange?.();
    await this.sound.play(this.media.sound, 0, this.seconds, isLooped);
  }

  pause(): void {
    if (!this.isPlaying) return;
    this.paused = this.sound.stop() % this.seconds;
    this.onChange?.();
  }

  async resume(): Promise<void> {
    if (!this.media || !this.rounds || this.paused === null) return;
    const from = this.paused;
    this.paused = null;
    this.rounds.rewind();
    this.moving = { position: -1, since: performance.now() };
    this.onChange?.();
    await this.sound.play(this.media.sound, from, this.seconds, this.rounds.isLooped);
  }

  stop(): void {
    this.sound.stop();
    this.rounds = this.paused = null;
  }

  /** Hides views, in studies that show one clip after the other. */
  cover(slots: readonly number[]): void {
    if (this.clipViews.every((view, slot) => view.covered === slots.includes(slot))) return;
    this.clipViews.forEach((view, slot) => (view.covered = slots.includes(slot)));
    this.redraw();
  }

  /** Fits the canvas to the views after a change of layout. */
  fit(): void {
    this.views.resize();
    this.redraw();
  }

  /** What is shown and heard, for tests. */
  get state(): {
    position: number | null;
    shown: number[];
    plays: readonly number[];
    watched: readonly number[];
    playing: readonly number[];
  } {
    const position = this.sound.position(performance.now());
    const shown = this.clipViews.map(({ second }) => second);
    return {
      position,
      shown,
      plays: this.counts.plays,
      watched: this.counts.watched,
      playing: this.isPlaying ? this.slots! : [],
    };
  }

  private redraw(): void {
    this.views.clear();
    for (const view of this.clipViews) view.dirty = true;
  }

  private picture(now: number): void {
    const gap = Math.max(0, now - this.last);
    this.last = now;
    this.interval += (Math.min(gap, SLOWEST_PICTURE) - this.interval) * 0.1;
    if (this.isPlaying) this.advance(now);
    this.clipViews.forEach((view, slot) => {
      if (!view.dirty || view.covered || !this.media) return;
      const clip = this.media.clips[slot]!;
      clip.pose(view.second, view.pose);
      this.views.draw({ element: view.element, pose: view.pose, centre: clip.centre(view.second) }, gap / 1000);
      view.dirty = false;
    });
  }

  /** Moves the playing views to the second that will be heard when the frame is on screen. */
  private advance(now: number): void {
    const position = this.sound.position(now + this.interval);
    if (position === null) return;
    this.watch(position, now);
    const rounds = this.rounds!;
    const { second, isOver, hasChanged } = rounds.at(position);
    for (const slot of rounds.slots) Object.assign(this.clipViews[slot]!, { second, dirty: true });
    this.onTime?.(second / this.seconds);
    if (isOver) this.stop();
    if (hasChanged) this.onChange?.();
    if (isOver) this.onEnd?.(rounds.slots);
  }

  private watch(position: number, now: number): void {
    if (position !== this.moving.position) this.moving = { position, since: now };
    else if (now - this.moving.since > STUCK_MS) {
      this.moving.since = now;
      this.onStuck?.();
    }
  }
}
