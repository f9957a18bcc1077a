/** AudioWorklet that plays the queue and reports which sample is output at which frame. It is the master clock. */

import { Playout } from "../playout.js";

declare const currentFrame: number;
declare const sampleRate: number;
declare class AudioWorkletProcessor {
  readonly port: MessagePort;
  constructor(options?: unknown);
}
declare function registerProcessor(name: string, processor: unknown): void;

export type PlaybackCommand =
  | { readonly type: "push"; readonly at: number; readonly pcm: Float32Array }
  | { readonly type: "flush"; readonly at: number }
  | { readonly type: "jump"; readonly at: number };

class Playback extends AudioWorkletProcessor {
  private readonly queue: Playout;
  private next = 0;

  constructor(options: { processorOptions: { jitter: number; chunk: number } }) {
    super(options);
    this.queue = new Playout(options.processorOptions.jitter, options.processorOptions.chunk);
    this.port.onmessage = ({ data }: MessageEvent<PlaybackCommand>) => {
      if (data.type === "push") this.queue.push(data.at, data.pcm);
      else if (data.type === "flush") this.queue.flush(data.at);
      else this.queue.jump(data.at);
      if (data.type !== "push") this.report(false);
    };
  }

  process(_inputs: Float32Array[][], outputs: Float32Array[][]): boolean {
    const channels = outputs[0]!;
    const marks = this.queue.process(channels[0]!, currentFrame);
    for (const channel of channels.slice(1)) channel.set(channels[0]!);
    for (const mark of marks) this.port.postMessage({ type: "mark", mark });
    if (currentFrame >= this.next) {
      this.next = currentFrame + sampleRate / 5;
      this.port.postMessage({ type: "tick", head: this.queue.head, end: this.queue.end });
    }
    return true;
  }

  private report(playing: boolean): void {
    const { head, underruns } = this.queue;
    this.port.postMessage({ type: "mark", mark: { frame: currentFrame, at: head, playing, underruns } });
  }
}

registerProcessor("echoavatar-playback", Playback);
