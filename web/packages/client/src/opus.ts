/** Decodes `opus` messages by WebCodecs. The clock of a block is its stream's first, and the samples decoded since. */

import type { PackedSoundMessage } from "./protocol.generated.js";

const CONFIG: AudioDecoderConfig = { codec: "opus", sampleRate: 48_000, numberOfChannels: 1 };
const PACKET_SECONDS = 0.02;

/** Whether this browser decodes Opus; `AudioDecoder` is there on https and localhost only. */
export async function canDecodeOpus(): Promise<boolean> {
  if (typeof AudioDecoder === "undefined") return false;
  return AudioDecoder.isConfigSupported(CONFIG).then(({ supported }) => supported === true, () => false);
}

export class OpusPlayer {
  private decoder: AudioDecoder | null = null;
  private turn = 0; // outputs of an earlier decoder are dropped
  private sent = 0; // packets of this stream
  private next = 0; // clock of the next sample decoded

  /** `onSound` gets mono samples at `rate` (24 or 48 kHz) and the clock of their first. */
  constructor(private readonly rate: number, private readonly onSound: (at: number, pcm: Float32Array<ArrayBuffer>) => void) {}

  take({ at, skip, packets }: PackedSoundMessage): void {
    if (skip || this.decoder?.state !== "configured") this.open(at, skip);
    for (const data of packets) {
      const timestamp = this.sent++ * PACKET_SECONDS * 1e6;
      this.decoder!.decode(new EncodedAudioChunk({ type: "key", timestamp, data: data.slice() }));
    }
  }

  /** Drops what is not decoded yet. */
  stop(): void {
    this.turn++;
    if (this.decoder && this.decoder.state !== "closed") this.decoder.close();
    this.decoder = null;
  }

  /** A new stream: nothing before `from` is played. */
  private open(from: number, skip: number): void {
    this.stop();
    [this.sent, this.next] = [0, from - skip];
    const turn = this.turn;
    this.decoder = new AudioDecoder({
      output: (sound) => {
        const block = mono(sound, this.rate);
        sound.close();
        if (turn !== this.turn) return;
        const early = Math.max(0, from - this.next);
        if (early < block.length) this.onSound(this.next + early, block.subarray(early));
        this.next += block.length;
      },
      error: (error) => {
        console.warn(`sound was lost: ${error.message}`);
        if (turn === this.turn) this.stop();
      },
    });
    this.decoder.configure(CONFIG);
  }
}

/** The first channel at `rate`. Sound of 24 kHz has nothing above 12 kHz, so every second sample of 48 kHz is enough. */
function mono(sound: AudioData, rate: number): Float32Array<ArrayBuffer> {
  const all = new Float32Array(sound.numberOfFrames);
  sound.copyTo(all, { planeIndex: 0, format: "f32-planar" });
  const step = Math.round(sound.sampleRate / rate);
  return step <= 1 ? all : all.filter((_, i) => i % step === 0);
}
