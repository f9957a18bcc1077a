/** Sound for a session: decoded files, speech in parts, a live stream. */

import type { Word } from "./protocol.generated.js";
import type { EchoSession } from "./session.js";
import type { Speaker, Utterance } from "./utterance.js";

const BLOCK = 2400; // captured samples per message: 0.1 s

/** Decodes a whole sound to mono at the session's rate. */
export async function decodeSound(data: ArrayBuffer, rate: number): Promise<Float32Array> {
  return mixed(await new OfflineAudioContext(1, 1, rate).decodeAudioData(data), rate);
}

/** Decoded sound as mono samples at a rate. */
export async function mixed(sound: AudioBuffer, rate: number): Promise<Float32Array> {
  const mono = new OfflineAudioContext(1, Math.max(1, Math.ceil(sound.duration * rate)), rate);
  const source = new AudioBufferSourceNode(mono, { buffer: sound });
  source.connect(mono.destination);
  source.start();
  return (await mono.startRendering()).getChannelData(0);
}

/** A piece of speech, and its words where the voice tells them. */
export interface Part {
  readonly samples: Float32Array;
  readonly words?: readonly Word[];
}

/** Sends sound as one utterance, each part as it comes, as long as `isWanted`; `begun` gets the utterance first. */
export async function say(
  session: EchoSession, parts: AsyncIterable<Part> | Iterable<Part>, isWanted: () => boolean, begun: (utterance: Utterance) => void,
): Promise<void> {
  let utterance: Utterance | null = null;
  try {
    for await (const { samples, words } of parts) {
      if (!isWanted()) return;
      if (!utterance) begun((utterance = session.speak()));
      utterance.tell(words ?? []);
      utterance.push(samples);
      session.pump();
    }
  } finally {
    utterance?.end();
    session.pump();
  }
}

/** Live sound, until `stop`. */
export class Capture {
  private constructor(
    private readonly stream: MediaStream,
    private readonly context: AudioContext,
    private readonly node: AudioWorkletNode,
    private readonly utterance: Utterance,
  ) {}

  /** Sends a stream's sound as an utterance. `worklet` is the address of the built `worklets/capture`. */
  static async start(
    session: EchoSession, stream: MediaStream, speaker: Speaker, worklet: string, onEnd: () => void, onBlock?: (block: Float32Array) => void,
  ): Promise<Capture> {
    const context = new AudioContext({ latencyHint: "interactive" });
    await context.audioWorklet.addModule(worklet);
    const rate = session.ready?.sample_rate ?? 24000;
    const node = new AudioWorkletNode(context, "echoavatar-capture", {
      numberOfOutputs: 0, processorOptions: { rate, block: BLOCK },
    });
    const utterance = session.speak(speaker);
    node.port.onmessage = ({ data }: MessageEvent<Float32Array>) => {
      utterance.push(data);
      session.pump();
      onBlock?.(data);
    };
    context.createMediaStreamSource(new MediaStream(stream.getAudioTracks())).connect(node);
    stream.getAudioTracks()[0]!.addEventListener("ended", onEnd);
    return new Capture(stream, context, node, utterance);
  }

  stop(): void {
    this.node.port.onmessage = null; // blocks may be on their way
    this.utterance.end();
    for (const track of this.stream.getTracks()) track.stop();
    void this.context.close();
  }
}
