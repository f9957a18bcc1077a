/** The application's view of a session: speak, act, interrupt, and get the picture to show. */

import { Connection, type ConnectionOptions, type LineState } from "./connection.js";
import { Emitter } from "./emitter.js";
import { type Picture, Player } from "./player.js";
import type { ActionStatusMessage, ErrorMessage as ServerError, FlushMessage, PackedSoundMessage, ReadyMessage, ServerMessage, SoundMessage, StateMessage, StatsMessage } from "./protocol.generated.js";
import { type Speaker, Utterance } from "./utterance.js";

export interface SessionEvents {
  /** A session started or was resumed (`resumed`). */
  ready: ReadyMessage;
  line: LineState;
  state: StateMessage;
  action: ActionStatusMessage;
  flush: FlushMessage;
  stats: StatsMessage;
  error: ServerError;
  /** Round-trip time of a ping in milliseconds. */
  roundTrip: number;
}

export interface SessionOptions extends ConnectionOptions {
  /** URL of the built `worklets/playback`; without a bundler the package finds its own. */
  readonly playbackWorklet?: string;
}

const PUMP_MS = 100;
const HERE = import.meta.url; // a name of its own, because bundlers would look for the script

export class EchoSession extends Emitter<SessionEvents> {
  ready: ReadyMessage | null = null;
  player: Player | null = null;
  private readonly connection: Connection;
  private readonly segments: { [speaker in Speaker]: number } = { avatar: 0, user: 0 };
  private utterances: Utterance[] = [];
  private output: { context: AudioContext; sink: AudioNode } | null = null;
  private node: AudioNode | null = null;
  private readonly pumping: ReturnType<typeof setInterval>;
  private requests = 0;
  private heardOf = { seg: 0, from: 0 }; // the newest utterance and the sample at which its sound began
  private ends: { seg: number; at: number; done: (heard: boolean) => void }[] = []; // of utterances, where they are known
  private awaited: { from: number; since: number } | null = null;
  /** Milliseconds from pushing the newest utterance's first sample to hearing and seeing it. */
  reaction = NaN;

  constructor(private readonly options: SessionOptions) {
    super();
    this.connection = new Connection(options, () => ({
      played: this.player?.received ?? 0,
      epoch: this.player?.played.epoch ?? null,
    }));
    this.connection.on("line", (line) => this.emit("line", line));
    this.connection.on("roundTrip", (milliseconds) => this.emit("roundTrip", milliseconds));
    this.connection.on("message", (message) => this.receive(message));
    this.pumping = setInterval(() => this.pump(), PUMP_MS);
  }

  connect(): void {
    this.connection.open();
  }

  /** Plays sound through `sink`; call it from a click. The context must run at `ready.sample_rate`. */
  async unlock(context: AudioContext, sink: AudioNode): Promise<void> {
    this.output = { context, sink };
    await context.resume();
    await this.attach();
  }

  /** The picture for a display frame that begins at `now` (`performance.now()`). */
  picture(now: number): Picture | null {
    const picture = this.player?.picture(now) ?? null;
    if (picture && this.awaited && picture.at >= this.awaited.from) {
      this.reaction = now - this.awaited.since;
      this.awaited = null;
    }
    return picture;
  }

  /** Starts an utterance; push sound to it, then end it. */
  speak(speaker: Speaker = "avatar"): Utterance {
    const utterance = new Utterance(++this.segments[speaker], speaker, this.ready?.sample_rate ?? 24000);
    this.utterances = [...this.utterances.filter((other) => !other.done).slice(-3), utterance];
    return utterance;
  }

  /** True when an utterance of the avatar was heard to its end, false when it was interrupted. */
  heard({ seg }: Utterance): Promise<boolean> {
    return new Promise((done) => this.ends.push({ seg, at: Infinity, done }));
  }

  /** Sends pushed sound now instead of at the next timer event. */
  pump(): void {
    if (!this.ready) return;
    const now = this.player?.heard ?? 0;
    for (const end of this.ends) if (end.at <= now) end.done(true);
    this.ends = this.ends.filter(({ at }) => at > now);
    for (const utterance of this.utterances) {
      if (this.connection.backlog < 1 << 20) utterance.pump((message) => this.connection.send(message));
    }
  }

  /** Stops the avatar at once and drops what it has not said yet. */
  interrupt(): void {
    if (!this.player) return;
    this.utterances = this.utterances.filter((utterance) => utterance.speaker !== "avatar");
    this.connection.send({ type: "interrupt", heard: this.player.interrupt(), seg: this.segments.avatar });
    this.forget();
  }

  /** Requests an action; `action` events with the returned id report its status. */
  act(name: string, settings: { intensity?: number; hold?: number } = {}): string {
    const id = `a${++this.requests}`;
    this.connection.send({ type: "action", id, name, ...settings });
    return id;
  }

  /** Changes how the speaker gestures from the next chunk on; what is absent stays as it is. See `ready.manner`. */
  manner(numbers: { liveliness?: number; handedness?: number }): void {
    this.connection.send({ type: "manner", ...numbers });
  }

  /** Plays one of the server's tracks, or stops the music. */
  music(op: "play" | "stop", title = ""): string {
    const id = `m${++this.requests}`;
    this.connection.send({ type: "music", id, op, title });
    return id;
  }

  close(): void {
    clearInterval(this.pumping);
    this.forget();
    this.connection.close();
    this.player?.close();
  }

  private receive(message: ServerMessage): void {
    switch (message.type) {
      case "ready":
        this.begin(message);
        break;
      case "motion":
        this.player?.takeMotion(message);
        break;
      case "audio":
        this.note(message);
        this.player?.takeSound(message);
        break;
      case "opus":
        this.note(this.aligned(message));
        this.player?.takePacked(message);
        break;
      case "flush":
        this.player?.takeFlush(message);
        this.emit("flush", message);
        break;
      case "action_status":
        this.emit("action", message);
        break;
      case "state":
        for (const end of this.ends) if (end.seg <= message.finished) end.at = Math.min(end.at, message.at);
        this.emit("state", message);
        break;
      case "stats":
        this.emit("stats", message);
        break;
      case "error":
        this.emit("error", message);
        break;
      case "pong":
        break;
    }
  }

  /** Packets begin a little before the chunk that they belong to. */
  private aligned({ at, seg }: PackedSoundMessage): { at: number; seg: number } {
    const chunk = this.ready?.chunk_samples ?? 1;
    return { at: Math.ceil(at / chunk) * chunk, seg };
  }

  /** The sample at which a new utterance begins. */
  private note({ seg, at }: Pick<SoundMessage, "seg" | "at">): void {
    if (seg === this.heardOf.seg) return;
    this.heardOf = { seg, from: at };
    const utterance = this.utterances.find((one) => one.seg === seg && one.speaker === "avatar");
    if (utterance?.begun) this.awaited = { from: at, since: utterance.begun };
  }

  private begin(ready: ReadyMessage): void {
    this.ready = ready;
    const current = this.utterances.find((utterance) => utterance.seg === ready.seg && utterance.speaker === "avatar");
    if (ready.resumed && this.player) {
      const heard = this.player.resume(ready);
      if (heard !== null) this.connection.send({ type: "interrupt", heard, seg: this.segments.avatar });
      current?.resume(ready.received);
    } else {
      this.renew(ready);
    }
    this.emit("ready", ready);
  }

  /** Handles a new session: the clock restarts, and sound that was not heard is sent again. */
  private renew(ready: ReadyMessage): void {
    const heard = this.player && this.heardOf.seg ? Math.max(0, this.player.heard - this.heardOf.from) : 0;
    for (const utterance of this.utterances) {
      utterance.restart(utterance.seg === this.heardOf.seg && utterance.speaker === "avatar" ? heard : 0);
    }
    this.player?.close();
    this.node?.disconnect();
    this.node = null;
    this.heardOf = { seg: 0, from: 0 };
    for (const end of this.ends) end.at = Infinity; // the clock begins anew
    this.player = new Player(ready, () => this.report());
    void this.attach();
  }

  private async attach(): Promise<void> {
    if (!this.output || !this.player || this.node || this.output.context.state !== "running") return;
    const { context, sink } = this.output;
    const player = this.player;
    const node = await player.attach(context, this.options.playbackWorklet ?? new URL("worklets/playback.js", HERE).href);
    if (player !== this.player) return node.disconnect();
    this.node = node;
    node.connect(sink);
  }

  /** Nothing of what was said will be heard any more. */
  private forget(): void {
    for (const { done } of this.ends) done(false);
    this.ends = [];
  }

  private report(): void {
    if (this.player) this.connection.send({ type: "played", ...this.player.played });
  }
}
