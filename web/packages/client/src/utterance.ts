/** Outgoing sound: cut into messages, paced, and kept until heard so that a broken connection loses nothing. */

import { floatToPcm } from "./codec.js";
import type { AudioMessage, ClientMessage, Word } from "./protocol.generated.js";

export type Speaker = NonNullable<AudioMessage["speaker"]>;

const MESSAGE_SAMPLES = 12_000; // half a second
const AHEAD_SECONDS = 12; // at most this far ahead of the wall clock: the server's input buffer is bounded
const KEEP_SECONDS = 60; // of sent sound, to send again after a reconnect

export class Utterance {
  private parts: Float32Array[] = []; // kept sound, starting at `from`
  private from = 0;
  private base = 0; // sound before this was heard in an earlier session and is not sent again
  private length = 0;
  private sent = 0;
  private ended = false;
  private endSent = false;
  private words: Word[] = []; // of the whole utterance
  private told = 0; // of them
  /** `performance.now()` of the first pushed sample; 0 before. */
  begun = 0;

  constructor(readonly seg: number, readonly speaker: Speaker, private readonly rate: number) {}

  /** Adds mono sound at the session's rate. */
  push(samples: Float32Array): void {
    if (this.ended || !samples.length) return;
    this.begun ||= performance.now();
    this.parts.push(samples);
    this.length += samples.length;
  }

  /** Tells the words of the sound that is pushed next, which may get gestures; times are seconds from its first sample. */
  tell(words: readonly Word[]): void {
    const since = this.seconds;
    for (const { text, start, end } of words) this.words.push({ text, start: since + start, end: end == null ? null : since + end });
  }

  /** Marks the utterance as complete. */
  end(): void {
    this.ended = true;
  }

  /** Seconds pushed so far. */
  get seconds(): number {
    return this.length / this.rate;
  }

  /** Whether everything was sent. */
  get done(): boolean {
    return this.endSent;
  }

  /** Sends what the pacing allows now. */
  pump(send: (message: ClientMessage) => boolean): void {
    const { seg, speaker } = this;
    if (this.told < this.words.length) {
      const heard = this.base / this.rate;
      const words = this.words.slice(this.told).filter(({ start }) => start >= heard);
      const later = words.map(({ text, start, end }) => ({ text, start: start - heard, end: end == null ? null : end - heard }));
      if (!send({ type: "words", seg, words: later })) return;
      this.told = this.words.length;
    }
    const limit = ((performance.now() - this.begun) / 1000 + AHEAD_SECONDS) * this.rate;
    while (this.sent < Math.min(this.length, limit)) {
      const samples = this.slice(this.sent, Math.min(this.length, this.sent + MESSAGE_SAMPLES));
      if (!send({ type: "audio", seg, start: this.sent - this.base, pcm: floatToPcm(samples), speaker })) return;
      this.sent += samples.length;
    }
    if (this.ended && this.sent === this.length && !this.endSent) this.endSent = send({ type: "end", seg, speaker });
    this.forget();
  }

  /** Continues in the resumed session, which has received `received` samples. */
  resume(received: number): void {
    this.sent = Math.max(this.from, Math.min(this.base + received, this.length));
    this.endSent = false;
  }

  /** Starts again in a new session with the sound that was not heard in the old one. */
  restart(heard: number): void {
    this.sent = this.base = Math.max(this.from, Math.min(this.base + heard, this.length));
    this.begun = performance.now() - (this.sent / this.rate) * 1000;
    this.endSent = false;
    this.told = 0;
  }

  private slice(from: number, to: number): Float32Array {
    const out = new Float32Array(to - from);
    let at = this.from;
    for (const part of this.parts) {
      const first = Math.max(from, at);
      const last = Math.min(to, at + part.length);
      if (first < last) out.set(part.subarray(first - at, last - at), first - from);
      at += part.length;
    }
    return out;
  }

  private forget(): void {
    while (this.parts.length && this.sent - (this.from + this.parts[0]!.length) > KEEP_SECONDS * this.rate) {
      this.from += this.parts.shift()!.length;
    }
  }
}
