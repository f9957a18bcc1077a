/** The dock: the sound sources, and the button that interrupts the avatar. */

import { Capture, type EchoSession, Output, type Part, type Picture, type Utterance, decodeSound, type protocol, say } from "@echoavatar/client";
import captureWorklet from "@echoavatar/client/worklets/capture?worker&url";
import { Chat } from "./chat.js";
import { icon } from "./icons.js";
import { openMenu, toast } from "./notices.js";
import { TextToSpeech } from "./texttospeech.js";
import { bytesOf, canShareTabs, fetchSound, openMicrophone, openTab, showLevel } from "./sources.js";

const SPEECH = "./sounds/speech.ogg";
type Name = "speech" | "music" | "microphone" | "file" | "tab" | "text" | "chat";
const LABELS: Record<Name, string> = {
  speech: "Speech", music: "Music", microphone: "Mic", file: "File", tab: "Tab", text: "Type", chat: "Chat",
};
const element = (id: string) => document.getElementById(id)!;

export class SourceBar {
  output: Output | null = null;
  /** Title of the track that plays, for the subtitle. */
  title = "";
  private readonly buttons = new Map<Name, HTMLButtonElement>();
  private capture: Capture | null = null;
  private active: Name | null = null;

  private readonly textToSpeech: TextToSpeech;
  private readonly chat: Chat;
  private readonly voiced: Promise<boolean>; // whether the server's machine has a voice
  private turn = 0; // counts sounds and interruptions
  private spoken: { readonly utterance: Utterance; until: number } | null = null; // the avatar's newest, until it was heard

  constructor(private readonly session: EchoSession, token: string) {
    this.textToSpeech = new TextToSpeech(token, () => this.rate, (parts) => this.speak("text", parts), (error) => toast(explain(error)));
    const told = this.textToSpeech.voices();
    this.voiced = told.then((voices) => !!voices?.voice);
    this.chat = new Chat(session, {
      token,
      voice: async (text) => ((await this.voiced) ? this.textToSpeech.speak(text) : null),
      say: (parts) => this.answer(parts),
      stopSpeech: () => this.stopSpeech(),
    });
    void this.chat.isPossible().then((possible) => this.show("chat", possible));
    void told.then((voices) => {
      this.show("text", !!voices?.voice);
      for (const note of document.querySelectorAll<HTMLElement>(".unvoiced")) {
        note.hidden = !!voices?.voice;
        note.querySelector("code")!.textContent = voices?.install ?? "";
      }
    });
    for (const name of Object.keys(LABELS) as Name[]) this.addButton(name);
    this.show("tab", canShareTabs());
    this.show("music", false);
    this.show("chat", false);
    this.show("text", false);
    session.on("ready", (ready) => this.offer(ready));
    session.on("action", ({ name, status }) => {
      if (!this.session.ready?.tracks.includes(name)) return;
      if (status === "started") this.title = name;
      else if (status === "done" && this.title === name) this.title = "";
    });
    session.on("state", ({ finished, at }) => {
      if (this.spoken && finished >= this.spoken.utterance.seg) this.spoken.until = Math.min(this.spoken.until, at);
    });
    const isWatching = "watch" in document.documentElement.dataset;
    if (isWatching) element("begin").textContent = "Hear it";
    element("begin").addEventListener("click", () => void (isWatching ? this.wake() : this.greet()));
    element("stop").addEventListener("click", () => this.interrupt());
    const input = element("file") as HTMLInputElement;
    input.addEventListener("change", () => {
      const files = [...(input.files ?? [])];
      input.value = "";
      this.onFiles(files);
    });
  }

  /** Called with chosen files; set by `connectDrop`. */
  onFiles: (files: readonly File[]) => void = () => {};

  /** Opens the audio output; call it from a click. */
  async wake(): Promise<void> {
    element("welcome").classList.add("gone");
    this.output ??= new Output(this.session.ready?.sample_rate ?? 24000);
    await this.session.unlock(this.output.context, this.output.input);
  }

  /** Presses a source's button; also called by the number keys. */
  async choose(name: Name): Promise<void> {
    const button = this.buttons.get(name)!;
    if (button.hidden) return;
    try {
      const waking = this.wake();
      if (name !== "text" && name !== "chat") await waking; // these open at once: Firefox never wakes without a sound device
      await Promise.all([this.run(name, button), waking]);
    } catch (error) {
      this.mark(null);
      toast(explain(error as Error));
    }
  }

  /** Begins to speak with a wave. */
  private async greet(): Promise<void> {
    await this.choose("speech");
    if (this.session.ready?.actions.includes("wave")) this.session.act("wave");
  }

  /** Plays a sound file. */
  async play(file: File): Promise<void> {
    await this.wake();
    const samples = await decodeSound(await bytesOf(file), this.rate).catch(() => {
      throw new Error(`“${file.name}” holds no sound that this browser can read.`);
    });
    await this.speak("file", [{ samples }]);
  }

  private async speak(name: Name, parts: AsyncIterable<Part> | Iterable<Part>): Promise<void> {
    await this.wake();
    this.replace(name);
    await this.hold(name, parts);
  }

  /** Plays the companion's speech; music continues under it. */
  private async answer(parts: AsyncIterable<Part>): Promise<void> {
    await this.wake();
    this.stopSpeech();
    await this.hold("chat", parts);
  }

  /** Says sound, and remembers it until it was heard; what comes after an interruption or the next sound is dropped. */
  private async hold(name: Name, parts: AsyncIterable<Part> | Iterable<Part>): Promise<void> {
    const turn = ++this.turn;
    await say(this.session, parts, () => turn === this.turn, (utterance) => {
      this.mark(name);
      this.spoken = { utterance, until: Infinity };
    });
  }

  /** Stops speech but not music. */
  private stopSpeech(): void {
    this.stopCapture();
    if (this.active) this.session.interrupt();
    this.drop();
  }

  /** Forgets the newest sound, also what of it is still to come. */
  private drop(): void {
    this.turn++;
    this.spoken = null;
  }

  interrupt(): void {
    this.chat.stop();
    this.stopCapture();
    this.session.music("stop");
    this.session.interrupt();
    this.drop();
    this.mark(null);
  }

  /** Whether the newest sound, its pauses included, is not over. */
  isSpeaking({ at }: Picture): boolean {
    return this.spoken !== null && at < this.spoken.until;
  }

  /** Whether anything can be interrupted. */
  set busy(busy: boolean) {
    (element("stop") as HTMLButtonElement).disabled = !busy && !this.capture;
    if (!busy && !this.capture && this.active) this.mark(null);
  }

  private get rate(): number {
    return this.session.ready?.sample_rate ?? 24000;
  }

  private addButton(name: Name): void {
    const button = document.createElement("button");
    button.className = "source";
    button.innerHTML = icon(name);
    button.append(LABELS[name]);
    button.setAttribute("aria-pressed", "false");
    button.dataset["source"] = name;
    button.onclick = () => void this.choose(name);
    this.buttons.set(name, button);
    element("sources").append(button);
  }

  private show(name: Name, shown: boolean): void {
    this.buttons.get(name)!.hidden = !shown;
  }

  private offer(ready: protocol.ReadyMessage): void {
    this.show("music", ready.tracks.length > 0);
    if (!ready.resumed) this.stopCapture();
  }

  private async run(name: Name, button: HTMLButtonElement): Promise<void> {
    if (this.capture && this.active === name) return this.interrupt();
    if (name === "speech") {
      await this.speak(name, [{ samples: await fetchSound(SPEECH, this.rate) }]);
    } else if (name === "music") this.chooseTrack(button);
    else if (name === "microphone") this.chooseSpeaker(button);
    else if (name === "tab") await this.listen("tab", await openTab(), "avatar");
    else if (name === "file") element("file").click();
    else if (name === "text") this.textToSpeech.toggle();
    else this.chat.toggle();
  }

  /** Ends the previous source and starts the next. */
  private replace(name: Name): void {
    const interrupted = this.active !== null || this.spoken !== null;
    this.stopCapture();
    this.drop();
    if (interrupted) {
      this.session.music("stop");
      this.session.interrupt();
    }
    this.mark(name);
  }

  private chooseTrack(button: HTMLButtonElement): void {
    const tracks = this.session.ready?.tracks ?? [];
    const play = (title: string) => {
      this.replace("music");
      this.session.music("play", title);
    };
    if (tracks.length === 1) return play(tracks[0]!);
    openMenu(button, tracks.map((title) => ({ label: title, run: () => play(title) })));
  }

  private chooseSpeaker(button: HTMLButtonElement): void {
    const listen = (speaker: "avatar" | "user") => {
      const opened = Promise.resolve().then(openMicrophone).then((stream) => this.listen("microphone", stream, speaker));
      opened.catch((error: Error) => toast(explain(error)));
    };
    openMenu(button, [
      { label: "Be the voice", hint: "The avatar moves as if your words, or your song, were its own.", run: () => listen("avatar") },
      { label: "Talk to the avatar", hint: "It listens to you: looks at you, nods when you pause.", run: () => listen("user") },
    ]);
  }

  private async listen(name: Name, stream: MediaStream, speaker: "avatar" | "user"): Promise<void> {
    this.replace(name);
    if (this.output) this.output.silent = name === "microphone"; // avoids feedback
    this.capture = await Capture.start(this.session, stream, speaker, captureWorklet, () => this.interrupt(), showLevel(this.buttons.get(name)!));
  }

  private stopCapture(): void {
    this.capture?.stop();
    this.capture = null;
    for (const name of ["microphone", "tab"] as const) this.buttons.get(name)!.style.removeProperty("--level");
    if (this.output) this.output.silent = false;
  }

  private mark(name: Name | null): void {
    this.active = name;
    for (const [other, button] of this.buttons) button.setAttribute("aria-pressed", String(other === name));
  }
}

function explain(error: Error): string {
  if (error.name === "NotAllowedError") return "The browser did not give access. Allow it in the address bar and try again.";
  if (error.name === "NotFoundError") return "No microphone was found.";
  return error.message;
}
