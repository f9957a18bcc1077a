/** Splits the microphone's sound into the visitor's turns at pauses. */

import { Capture, type EchoSession, floatToPcm } from "@echoavatar/client";
import captureWorklet from "@echoavatar/client/worklets/capture?worker&url";
import { openMicrophone } from "./sources.js";

const LOUD = 0.015; // RMS of a 0.1 s block, relative to full scale
const PAUSE_BLOCKS = 8;
const SHORTEST_BLOCKS = 3; // shorter turns are ignored as noise
const LONGEST_BLOCKS = 300;
const BEFORE_BLOCKS = 3; // kept from before the threshold was crossed, because words begin softly

export interface TurnEvents {
  readonly begun: () => void;
  readonly ended: (wav: Blob) => void;
  /** Called with each block of sound. */
  readonly block: (samples: Float32Array) => void;
}

export class Turns {
  private capture: Capture | null = null;
  private blocks: Float32Array[] = [];
  private loud = 0;
  private quiet = 0;
  private speaking = false;

  constructor(private readonly session: EchoSession, private readonly events: TurnEvents) {}

  get isOpen(): boolean {
    return this.capture !== null;
  }

  async open(): Promise<void> {
    const stream = await openMicrophone();
    this.capture = await Capture.start(this.session, stream, "user", captureWorklet, () => this.stop(), (block) => this.hear(block));
  }

  stop(): void {
    this.capture?.stop();
    this.capture = null;
    this.forget();
  }

  private hear(block: Float32Array): void {
    this.events.block(block);
    const level = Math.sqrt(block.reduce((sum, value) => sum + value * value, 0) / block.length);
    this.blocks.push(block);
    if (level > LOUD) {
      this.loud++;
      this.quiet = 0;
    } else this.quiet++;
    if (!this.speaking && this.loud >= SHORTEST_BLOCKS) {
      this.speaking = true;
      this.events.begun();
    }
    if (this.speaking && (this.quiet >= PAUSE_BLOCKS || this.blocks.length > LONGEST_BLOCKS)) {
      this.events.ended(toWav(this.blocks, this.session.ready?.sample_rate ?? 24000));
      this.forget();
    } else if (!this.speaking && this.quiet >= PAUSE_BLOCKS) {
      this.loud = 0;
      this.blocks = this.blocks.slice(-BEFORE_BLOCKS);
    }
  }

  private forget(): void {
    this.blocks = [];
    this.loud = this.quiet = 0;
    this.speaking = false;
  }
}

/** Encodes blocks of mono sound as a 16-bit WAV file. */
export function toWav(blocks: readonly Float32Array[], rate: number): Blob {
  const data = blocks.map((block) => floatToPcm(block));
  const length = data.reduce((sum, part) => sum + part.length, 0);
  const head = new DataView(new ArrayBuffer(44));
  const text = (at: number, letters: string) => [...letters].forEach((letter, k) => head.setUint8(at + k, letter.charCodeAt(0)));
  text(0, "RIFF");
  head.setUint32(4, 36 + length, true);
  text(8, "WAVEfmt ");
  head.setUint32(16, 16, true);
  head.setUint16(20, 1, true);
  head.setUint16(22, 1, true);
  head.setUint32(24, rate, true);
  head.setUint32(28, 2 * rate, true);
  head.setUint16(32, 2, true);
  head.setUint16(34, 16, true);
  text(36, "data");
  head.setUint32(40, length, true);
  return new Blob([head.buffer, ...(data as BlobPart[])], { type: "audio/wav" });
}
