/**
 * `<echo-avatar server="https://avatar.example.org">`: an avatar of an EchoAvatar server in any page. It opens a session
 * when it is put into a page and ends it when it is taken out. Any number of them may be in a page.
 */

import { DetailControl } from "./drivers/detail.js";
import type { StageName } from "./drivers/light.js";
import { Stage, type ViewName } from "./drivers/stage.js";
import { Output } from "./output.js";
import type { ActionStatusMessage, BodyOptions, ErrorMessage as ServerError, MotionMessage, ReadyMessage } from "./protocol.generated.js";
import { Resampler } from "./resample.js";
import { Posture } from "./rest.js";
import { EchoSession } from "./session.js";
import { Capture, type Part, decodeSound, mixed, say } from "./sound.js";
import type { Speaker, Utterance } from "./utterance.js";
import { spoken } from "./voice.js";

/** What `send` takes: a sound file (bytes, or its address), decoded sound, mono samples, also as they come, or a live stream. */
export type Sound = string | URL | Blob | ArrayBuffer | AudioBuffer | Float32Array | AsyncIterable<Float32Array> | MediaStream;

export interface SendOptions {
  /** `user`: the avatar listens to it instead of saying it. */
  readonly speaker?: Speaker;
  /** Samples per second of a Float32Array; the session's if absent. */
  readonly rate?: number;
}

export interface EchoAvatarEvents {
  /** A session began or continues. */
  ready: CustomEvent<ReadyMessage>;
  /** What the avatar shows has changed, such as from `idle` to `speaking`. */
  state: CustomEvent<MotionMessage["state"]>;
  /** An action was accepted, started, is done, or was rejected. */
  action: CustomEvent<ActionStatusMessage>;
  /** Something does not work; the element shows the same message. */
  error: ErrorEvent;
}

/** How far the body may go, by the `mode` attribute. */
const BODIES: Readonly<Record<string, BodyOptions>> = { free: {}, "in-place": { in_place: true }, "upper-body": { upper_body: true } };
const OPENED_BY = ["server", "token", "mode", "seed", "watch"] as const;
const SENT_MS = 50; // between looks at whether an utterance was sent
const WAKING = ["click", "keydown", "touchend"] as const; // after which browsers let a page be heard
const STYLE = `
:host { display: block; position: relative; height: 480px; overflow: hidden; }
:host([hidden]) { display: none; }
#stage { position: absolute; inset: 0; }
#message, #hear { position: absolute; left: 50%; bottom: 12px; transform: translateX(-50%); margin: 0; padding: 8px 14px;
  font: 14px/1.4 system-ui, sans-serif; color: #16212c; background: #fffffff0; border: 1px solid #0002; border-radius: 10px; }
#message { box-sizing: border-box; width: max-content; max-width: calc(100% - 24px); text-align: center; overflow-wrap: anywhere; }
#hear { cursor: pointer; }
#message:empty, #message:not(:empty) ~ #hear, #hear[hidden] { display: none; }
`;

// Node reads this file too, where pages are rendered on a server.
const Base = globalThis.HTMLElement ?? (class {} as typeof HTMLElement);

export class EchoAvatarElement extends Base {
  static readonly observedAttributes = [...OPENED_BY, "character", "view", "light", "muted"];
  /** The server of elements that name none; set where a server serves this script. */
  static home = "";
  /** Where the built worklets `playback.js` and `capture.js` are; absent: on the server. */
  static worklets = "";

  /** The session, for what this element does not offer; null while the element is not in a page. */
  session: EchoSession | null = null;
  /** What the avatar does now. */
  state: MotionMessage["state"] = "idle";
  private stage: Stage | null = null;
  private readonly box: HTMLElement | null = null;
  private readonly message: HTMLElement | null = null;
  private readonly hear: HTMLButtonElement | null = null;
  private posture = new Posture();
  private detail = new DetailControl(true);
  private output: Output | null = null;
  private stopListening: (() => void) | null = null; // to a stream
  private opened = ""; // by which attributes
  private isSettling = false;
  private saying: Promise<unknown> = Promise.resolve();
  private turn = 0;
  private picture = 0; // the next display frame
  private drawnAt = 0;
  private isSeen = true;
  private eyes: IntersectionObserver | null = null;

  constructor() {
    super();
    const root = this.attachShadow({ mode: "open" });
    const style = new CSSStyleSheet(); // which pages without 'unsafe-inline' allow
    style.replaceSync(STYLE);
    root.adoptedStyleSheets = [style];
    this.box = Object.assign(document.createElement("div"), { id: "stage" });
    this.message = Object.assign(document.createElement("p"), { id: "message" });
    this.message.setAttribute("role", "status");
    this.hear = Object.assign(document.createElement("button"), { id: "hear", type: "button", textContent: "Hear it", hidden: true });
    this.message.part.add("message");
    this.hear.part.add("hear");
    root.append(this.box, this.message, this.hear);
  }

  connectedCallback(): void {
    this.settle();
  }

  disconnectedCallback(): void {
    this.settle();
  }

  attributeChangedCallback(name: string, before: string | null, after: string | null): void {
    if (before === after) return;
    if (name === "muted") this.applyMuted();
    else if (!this.stage) this.settle();
    else if (name === "view") this.stage.view = this.view;
    else if (name === "light") this.stage.light = this.light;
    else if (name === "character") void this.dress();
    else this.settle();
  }

  /** Address of the server. */
  get server(): string {
    return this.getAttribute("server") ?? EchoAvatarElement.home;
  }
  set server(value: string) {
    this.setAttribute("server", value);
  }

  /** The server's token, if it has one. */
  get token(): string {
    return this.getAttribute("token") ?? "";
  }
  set token(value: string) {
    this.setAttribute("token", value);
  }

  /** A character of the server, or the address of a .vrm or .glb; empty: the server's first. */
  get character(): string {
    return this.getAttribute("character") ?? "";
  }
  set character(value: string) {
    this.setAttribute("character", value);
  }

  /** What the camera shows: `full`, `bust` or `face`. */
  get view(): ViewName {
    return (this.getAttribute("view") ?? "full") as ViewName;
  }
  set view(value: ViewName) {
    this.setAttribute("view", value);
  }

  /** The light: `studio`, or another of `STAGES`. */
  get light(): StageName {
    return (this.getAttribute("light") ?? "studio") as StageName;
  }
  set light(value: StageName) {
    this.setAttribute("light", value);
  }

  /** How far the body goes: `free`, `in-place` or `upper-body`. */
  get mode(): string {
    return this.getAttribute("mode") ?? "free";
  }
  set mode(value: string) {
    this.setAttribute("mode", value);
  }

  /** The session of another program to watch; empty: a session of one's own. */
  get watch(): string {
    return this.getAttribute("watch") ?? "";
  }
  set watch(value: string) {
    this.setAttribute("watch", value);
  }

  get muted(): boolean {
    return this.hasAttribute("muted");
  }
  set muted(value: boolean) {
    this.toggleAttribute("muted", value);
  }

  /** Says a text with the server's voice, after what was said before. True when it was heard, false when interrupted. */
  async speak(text: string): Promise<boolean> {
    const session = await this.begun();
    return this.hold(session, spoken(text, this.address, session.ready!.sample_rate, this.token));
  }

  /** Says a sound, after what was said before. True when it was heard, false when interrupted. A stream is said until it ends. */
  async send(sound: Sound, { speaker = "avatar", rate }: SendOptions = {}): Promise<boolean> {
    const session = await this.begun();
    if (sound instanceof MediaStream) return this.follow(session, sound, speaker);
    const parts = partsOf(sound, session.ready!.sample_rate, rate);
    if (speaker === "avatar") return this.hold(session, parts);
    const heard = session.speak("user");
    for await (const { samples } of parts) heard.push(samples);
    heard.end();
    return true;
  }

  /** Asks for an action of `ready.actions`; `action` events tell what becomes of it. */
  act(name: string, settings: { intensity?: number; hold?: number } = {}): void {
    void this.begun().then((session) => session.act(name, settings), () => undefined);
  }

  /** Stops the avatar at once and drops what it has not said yet. */
  interrupt(): void {
    this.turn++;
    this.stopListening?.();
    this.session?.interrupt();
  }

  /** Lets the avatar be heard; call it from a click of the page. Any click or key does the same by itself. */
  async unlock(): Promise<void> {
    const { session } = this;
    if (!session || this.muted) return;
    this.output ??= new Output(session.ready?.sample_rate ?? 24000);
    this.output.muted = false;
    await session.unlock(this.output.context, this.output.input);
    this.hear!.hidden = true;
  }

  private get isAudible(): boolean {
    return this.output?.context.state === "running";
  }

  /** The server's address with a slash at its end; throws what is wrong with it. */
  private get address(): string {
    const given = this.server;
    if (!given) throw new Error('<echo-avatar> needs the address of a server, such as server="http://127.0.0.1:8765".');
    const found = new URL(URL.canParse(given, document.baseURI) ? given : "none:", document.baseURI);
    if (!/^https?:$/.test(found.protocol)) throw new Error(`“${given}” is not the address of a server; write it as https://avatar.example.org.`);
    if (location.protocol === "https:" && found.protocol === "http:" && !/^(localhost|127\.|\[::1\])/.test(found.hostname))
      throw new Error(`This page is https, so it may not load from ${found.origin}: give the server a certificate, or put a proxy with TLS before it.`);
    found.hash = found.search = "";
    return found.href.replace(/\/?$/, "/");
  }

  /** Opens or ends the session once the page has set all it sets; an element that is only moved goes on. */
  private settle(): void {
    if (this.isSettling) return;
    this.isSettling = true;
    queueMicrotask(() => {
      this.isSettling = false;
      const wished = this.isConnected ? JSON.stringify(OPENED_BY.map((name) => this.getAttribute(name))) : "";
      if (wished === this.opened) return;
      if (this.opened) this.end();
      this.opened = wished;
      if (!wished) return;
      try {
        this.begin();
      } catch (error) {
        this.fail(error as Error);
      }
    });
  }

  private begin(): void {
    this.say("");
    const { address } = this;
    const body = BODIES[this.mode];
    if (!body) throw new Error(`mode “${this.mode}” is none of ${Object.keys(BODIES).join(", ")}.`);
    try {
      this.stage = new Stage(this.box!, { view: this.view, light: this.light });
    } catch {
      throw new Error("This browser shows no WebGL here, which draws the avatar. Turn hardware acceleration on, or close other pages with 3D.");
    }
    this.detail = new DetailControl(this.stage.low);
    this.posture = new Posture();
    const session = (this.session = new EchoSession({
      url: `${address.replace(/^http/, "ws")}v1/stream`,
      token: this.token, seed: Number(this.getAttribute("seed") ?? 0), body,
      role: this.watch ? "viewer" : "source", session: this.watch,
      playbackWorklet: this.worklet("playback"),
    }));
    let [wasReady, isRefused] = [false, false];
    session.on("ready", (ready) => {
      [wasReady, isRefused] = [true, false];
      this.say("");
      if (!this.stage!.avatar) void this.dress(); // the server may have come up only now
      this.stage!.bind(ready);
      this.posture.bind(ready);
      this.applyMuted();
      this.fire("ready", ready);
    });
    session.on("action", (status) => this.fire("action", status));
    session.on("error", (error) => {
      isRefused = true;
      this.fail(new Error(told(error)), error.place > 0);
    });
    session.on("line", (line) => {
      if (line === "waiting" && !isRefused) this.fail(new Error(wasReady ? "The line broke; trying again." : silent(address)));
    });
    void this.dress();
    this.eyes = new IntersectionObserver((seen) => (this.isSeen = seen.at(-1)!.isIntersecting));
    this.eyes.observe(this);
    this.drawnAt = performance.now();
    this.picture = requestAnimationFrame(() => this.draw());
    session.connect();
  }

  private end(): void {
    cancelAnimationFrame(this.picture);
    this.eyes?.disconnect();
    this.interrupt();
    this.session?.close();
    this.session = null;
    void this.output?.context.close();
    this.output = null;
    this.listenForClicks(false);
    this.stage?.close();
    this.stage = null;
    this.show("idle");
    this.say("");
    this.dispatchEvent(new Event("end")); // for calls that wait for a session
  }

  private draw(): void {
    this.picture = requestAnimationFrame(() => this.draw());
    const { session, stage } = this;
    if (!session || !stage) return;
    const now = performance.now();
    const seconds = (now - this.drawnAt) / 1000;
    this.drawnAt = now;
    const picture = session.picture(now);
    if (picture) this.show(picture.state);
    const pose = this.posture.show(picture, seconds);
    if (!this.isSeen) return;
    stage.avatar?.apply(pose);
    stage.avatar?.update(seconds);
    stage.isCheapest = this.detail.isCheapest;
    stage.draw();
    if (stage.avatar && this.detail.picture(seconds)) void this.dress();
  }

  private async dress(): Promise<void> {
    try {
      const { character } = this;
      const own = `${this.address}avatar.glb?${character ? `character=${encodeURIComponent(character)}&` : ""}level=${this.detail.level}`;
      await this.stage?.wear(/[/.]/.test(character) ? new URL(character, document.baseURI).href : own);
      this.detail.restart();
    } catch (error) {
      const isSilent = error instanceof TypeError && !this.session?.ready; // as fetch names an address that does not answer
      this.fail(new Error(isSilent ? silent(this.address) : `The character could not be shown: ${(error as Error).message}`));
    }
  }

  /** The session, once it has begun. */
  private begun(): Promise<EchoSession> {
    const { session } = this;
    if (session?.ready) return Promise.resolve(session);
    if (!this.isConnected) return Promise.reject(new Error("This <echo-avatar> is in no page, so it has no session."));
    return new Promise((done, fail) => {
      this.addEventListener("ready", () => done(this.session!), { once: true });
      this.addEventListener("end", () => fail(new Error("The <echo-avatar> was taken out of the page.")), { once: true });
    });
  }

  /** Says parts of a sound once all before it was sent. */
  private async hold(session: EchoSession, parts: AsyncIterable<Part>): Promise<boolean> {
    const turn = this.turn;
    const isWanted = () => turn === this.turn && session === this.session;
    let heard: Promise<boolean> | null = null;
    const sent = this.saying.then(async () => {
      if (!isWanted()) return;
      this.say("");
      let sending: Utterance | null = null;
      await say(session, parts, isWanted, (utterance) => {
        sending = utterance;
        heard = session.heard(utterance);
      });
      while (sending && !(sending as Utterance).done && isWanted()) await new Promise((done) => setTimeout(done, SENT_MS));
    });
    this.saying = sent.catch((error: Error) => this.fail(error));
    await sent;
    return heard ?? false;
  }

  private async follow(session: EchoSession, stream: MediaStream, speaker: Speaker): Promise<boolean> {
    this.interrupt();
    const turn = this.turn;
    const over = new Promise<void>((done) => (this.stopListening = done));
    const capture = await Capture.start(session, stream, speaker, this.worklet("capture"), this.stopListening!);
    await over;
    capture.stop();
    return turn === this.turn;
  }

  private worklet(name: string): string {
    return new URL(`${name}.js`, EchoAvatarElement.worklets || `${this.address}client/worklets/`).href;
  }

  private applyMuted(): void {
    if (this.output) this.output.muted = this.muted;
    const wakes = !this.muted && !this.isAudible && this.session !== null;
    this.hear!.hidden = !wakes;
    this.listenForClicks(wakes);
    if (wakes && navigator.userActivation?.hasBeenActive) void this.wake();
  }

  private listenForClicks(wanted: boolean): void {
    for (const name of WAKING) {
      if (wanted) document.addEventListener(name, this.wake, true);
      else document.removeEventListener(name, this.wake, true);
    }
  }

  private readonly wake = (): Promise<void> =>
    this.unlock().then(() => this.listenForClicks(!this.isAudible && !this.muted), (error: Error) => this.fail(new Error(`The avatar cannot be heard: ${error.message}`)));

  private show(state: MotionMessage["state"]): void {
    if (state === this.state) return;
    this.state = state;
    this.fire("state", state);
  }

  private say(text: string): void {
    this.message!.textContent = text;
  }

  /** Shows what is wrong and tells the page; a place in a queue is shown only. */
  private fail(error: Error, isPlace = false): void {
    if (error.message === this.message!.textContent) return;
    this.say(error.message);
    if (!isPlace) this.dispatchEvent(new ErrorEvent("error", { message: error.message, error }));
  }

  private fire(name: keyof EchoAvatarEvents, detail: unknown): void {
    this.dispatchEvent(new CustomEvent(name, { detail }));
  }
}

/* What TypeScript and frameworks know of the element's events. */
export interface EchoAvatarElement {
  addEventListener<Name extends keyof EchoAvatarEvents>(name: Name, listener: (event: EchoAvatarEvents[Name]) => void, options?: boolean | AddEventListenerOptions): void;
  addEventListener(name: string, listener: EventListenerOrEventListenerObject, options?: boolean | AddEventListenerOptions): void;
}

declare global {
  interface HTMLElementTagNameMap {
    "echo-avatar": EchoAvatarElement;
  }
}

function silent(address: string): string {
  return `The server at ${address} does not answer; trying again.`;
}

function told({ code, message, place }: ServerError): string {
  if (place) return `All places are taken. ${place === 1 ? "You are next" : `You are number ${place} in the queue`}.`;
  if (code === "unauthorized") return 'The server asks for its token: set token="...".';
  return message.charAt(0).toUpperCase() + message.slice(1);
}

async function* partsOf(sound: Exclude<Sound, MediaStream>, rate: number, given = rate): AsyncGenerator<Part> {
  if (typeof sound === "string" || sound instanceof URL) {
    const answer = await fetch(sound);
    if (!answer.ok) throw new Error(`${String(sound)} answered ${answer.status}`);
    yield* partsOf(await answer.arrayBuffer(), rate);
  } else if (sound instanceof Blob) yield* partsOf(await sound.arrayBuffer(), rate);
  else if (sound instanceof ArrayBuffer) yield { samples: await decodeSound(sound.slice(0), rate) };
  else if (sound instanceof AudioBuffer) yield { samples: await mixed(sound, rate) };
  else {
    const resampler = new Resampler(given, rate);
    for await (const samples of sound instanceof Float32Array ? [sound] : sound) yield { samples: given === rate ? samples : resampler.push(samples) };
  }
}

if (globalThis.customElements && !customElements.get("echo-avatar")) customElements.define("echo-avatar", EchoAvatarElement);
