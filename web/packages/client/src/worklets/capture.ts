/** AudioWorklet that captures a microphone or a tab: mixes to mono, resamples to the session's rate, posts blocks. */

import { Resampler } from "../resample.js";

declare const sampleRate: number;
declare class AudioWorkletProcessor {
  readonly port: MessagePort;
  constructor(options?: unknown);
}
declare function registerProcessor(name: string, processor: unknown): void;

class Capture extends AudioWorkletProcessor {
  private readonly resampler: Resampler;
  private readonly block: Float32Array;
  private filled = 0;

  constructor(options: { processorOptions: { rate: number; block: number } }) {
    super(options);
    this.resampler = new Resampler(sampleRate, options.processorOptions.rate);
    this.block = new Float32Array(options.processorOptions.block);
  }

  process(inputs: Float32Array[][]): boolean {
    const channels = inputs[0] ?? [];
    if (!channels.length) return true;
    const mono = new Float32Array(channels[0]!.length);
    for (const channel of channels) for (let i = 0; i < mono.length; i++) mono[i]! += channel[i]! / channels.length;
    for (const sample of this.resampler.push(mono)) {
      this.block[this.filled++] = sample;
      if (this.filled === this.block.length) {
        this.port.postMessage(this.block.slice());
        this.filled = 0;
      }
    }
    return true;
  }
}

registerProcessor("echoavatar-capture", Capture);
