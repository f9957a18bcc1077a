/** The page's audio output: one context, the volume, a level meter and a tap for recordings. */

export class Output {
  readonly context: AudioContext;
  readonly input: GainNode;
  readonly recording: MediaStreamAudioDestinationNode;
  private readonly volume: GainNode;
  private readonly analyser: AnalyserNode;
  private readonly samples = new Float32Array(512);
  private audible = true;
  private isSilenced = false;

  /** Call it from a click; otherwise the browser keeps it silent. */
  constructor(rate: number) {
    this.context = new AudioContext({ sampleRate: rate, latencyHint: "interactive" });
    this.input = this.context.createGain();
    this.volume = this.context.createGain();
    this.analyser = new AnalyserNode(this.context, { fftSize: 512 });
    this.recording = this.context.createMediaStreamDestination();
    this.input.connect(this.analyser);
    this.input.connect(this.volume).connect(this.context.destination);
    this.input.connect(this.recording);
  }

  /** Loudness of the output, 0 to 1. */
  get level(): number {
    this.analyser.getFloatTimeDomainData(this.samples);
    const power = this.samples.reduce((sum, x) => sum + x * x, 0) / this.samples.length;
    return Math.min(1, Math.sqrt(power) * 4);
  }

  get muted(): boolean {
    return !this.audible;
  }

  set muted(muted: boolean) {
    this.audible = !muted;
    this.apply();
  }

  /** Mutes the output regardless of the volume setting. */
  set silent(silent: boolean) {
    this.isSilenced = silent;
    this.apply();
  }

  private apply(): void {
    const gain = this.audible && !this.isSilenced ? 1 : 0;
    this.volume.gain.setTargetAtTime(gain, this.context.currentTime, 0.02);
  }
}
