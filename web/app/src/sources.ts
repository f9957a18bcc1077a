/** Sound sources: bundled sound, files, the microphone, another tab. Each becomes utterances of a session. */

import type { EchoSession, Speaker, Utterance, protocol } from "@echoavatar/client";
import captureWorklet from "@echoavatar/client/worklets/capture?worker&url";

const BLOCK = 2400; // captured samples per message: 0.1 s

/** Decodes a whole sound to mono at the session's rate. */
export async function decodeSound(data: ArrayBuffer, rate: number): Promise<Float32Array> {
  const sound = await new OfflineAudioContext(1, 1, rate).decodeAudioData(data);
  const mono = new OfflineAudioContext(1, Math.max(1, Math.ceil(sound.duration * rate)), rate);
  const source = new AudioBufferSourceNode(mono, { buffer: sound });
  source.connect(mono.destination);
  source.start();
  return (await mono.startRendering()).getChannelData(0);
}

/** The bytes of a chosen file; throws an error that names it. */
export function bytesOf(file: File): Promise<ArrayBuffer> {
  return file.arrayBuffer().catch((error: Error) => {
    throw new Error(`“${file.name}” cannot be read (${error.message}). Choose it again.`);
  });
}

export async function fetchSound(url: string, rate: number): Promise<Float32Array> {
  const response = await fetch(url);
  if (!response.ok) throw new Error(`${url} is not there (${response.status}).`);
  return decodeSound(await response.arrayBuffer(), rate);
}

/** A piece of speech, and its words where the voice tells them. */
export interface Part {
  readonly samples: Float32Array;
  readonly words?: readonly protocol.Word[];
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

  static async start(
    session: EchoSession, stream: MediaStream, speaker: Speaker, onEnd: () => void, onBlock?: (block: Float32Array) => void,
  ): Promise<Capture> {
    const context = new AudioContext({ latencyHint: "interactive" });
    await context.audioWorklet.addModule(captureWorklet);
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

/** Shows how loud captured sound is, on the button that captures it. */
export function showLevel(button: HTMLElement): (block: Float32Array) => void {
  return (block) => {
    const power = block.reduce((sum, value) => sum + value * value, 0) / block.length;
    button.style.setProperty("--level", String(Math.min(1, Math.max(0, 1 + Math.log10(power + 1e-9) / 5)).toFixed(2))); // -50 dB is none
  };
}

export function openMicrophone(): Promise<MediaStream> {
  if (!navigator.mediaDevices?.getUserMedia) throw new Error("The microphone needs https:// or localhost.");
  return navigator.mediaDevices.getUserMedia({
    audio: { echoCancellation: true, noiseSuppression: true, autoGainControl: true },
  });
}

/** Captures another tab. Where the browser allows it, that tab is muted and its sound plays here, in sync. */
export async function openTab(): Promise<MediaStream> {
  const stream = await navigator.mediaDevices.getDisplayMedia({
    video: true,
    audio: { suppressLocalAudioPlayback: true, echoCancellation: false, noiseSuppression: false, autoGainControl: false } as MediaTrackConstraints,
  });
  for (const track of stream.getVideoTracks()) track.enabled = false;
  if (stream.getAudioTracks().length) return stream;
  for (const track of stream.getTracks()) track.stop();
  throw new Error("That share has no sound: choose a tab and tick “Also share tab audio”.");
}

export const canShareTabs = () => !!navigator.mediaDevices?.getDisplayMedia && !matchMedia("(pointer: coarse)").matches;
