/** Sound on its way up: cut into messages, paced, and kept until heard so that a broken line loses nothing. */

import { floatToPcm } from "./codec.js";
import type { AudioMessage, ClientMessage } from "./protocol.generated.js";

export type Speaker = NonNullable<AudioMessage["speaker"]>;

const MESSAGE_SAMPLES = 12_000; // half a second
const AHEAD_SECONDS = 12; // sent ahead of the wall clock at most: the server's inbox is bounded
const KEEP_SECONDS = 60; // of sent sound, for a resumed session

export class Utterance {
  private parts: Float32Array[] = []; // kept sound, from `from` on
  private from = 0;
  private base = 0; // what an earlier session heard is not sent to the next
  private length = 0;
  private sent = 0;
  private ended = false;
  private endSent = false;
  /** When the first sample came, by `performance.now()`; 0 before. */
  begun = 0;

  constructor(readonly seg: number, readonly speaker: Speaker, private readonly rate: number) {}

  /** Adds sound, mono at the session's rate. */
  push(samples: Float32Array): void {
    if (this.ended || !samples.length) return;
    this.begun ||= performance.now();
    this.parts.push(samples);
    this.length += samples.length;
  }

  /** No more will come. */
  end(): void {
    this.ended = true;
  }

  /** Seconds pushed so far. */
  get seconds(): number {
    return this.length / this.rate;
  }

  /** Whether all was handed over. */
  get done(): boolean {
    return this.endSent;
  }

  /** Sends what may be sent now. */
  pump(send: (message: ClientMessage) => boolean): void {
    const { seg, speaker } = this;
    const limit = ((performance.now() - this.begun) / 1000 + AHEAD_SECONDS) * this.rate;
    while (this.sent < Math.min(this.length, limit)) {
      const samples = this.slice(this.sent, Math.min(this.length, this.sent + MESSAGE_SAMPLES));
      if (!send({ type: "audio", seg, start: this.sent - this.base, pcm: floatToPcm(samples), speaker })) return;
      this.sent += samples.length;
    }
    if (this.ended && this.sent === this.length && !this.endSent) this.endSent = send({ type: "end", seg, speaker });
    this.forget();
  }

  /** The same session, resumed, has `received` samples: go on there. */
  resume(received: number): void {
    this.sent = Math.max(this.from, Math.min(this.base + received, this.length));
    this.endSent = false;
  }

  /** A new session knows nothing: give it what was not heard by the old one. */
  restart(heard: number): void {
    this.sent = this.base = Math.max(this.from, Math.min(this.base + heard, this.length));
    this.begun = performance.now() - (this.sent / this.rate) * 1000;
    this.endSent = false;
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
