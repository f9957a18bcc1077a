/** The chat box: what the visitor types or says goes to the server's companion, whose answer the avatar says and does. */

import type { EchoSession } from "@echoavatar/client";
import { toast } from "./notices.js";
import { Turns } from "./turns.js";

const element = <Kind extends HTMLElement>(id: string) => document.getElementById(id) as Kind;
const SHOWN = 4; // sayings in view

interface Saying {
  readonly role: "user" | "assistant";
  readonly text: string;
}

export interface ChatParts {
  readonly token: string;
  /** Speaks text: the sound of it, or null where there is no voice. */
  readonly voice: (text: string) => Promise<Float32Array | null>;
  /** The avatar says a sound; the promise is kept when it was handed over. */
  readonly say: (samples: Float32Array) => Promise<void>;
  /** What the avatar says is cut off. */
  readonly hush: () => void;
}

export class Chat {
  private readonly headers: Record<string, string>;
  private readonly history: Saying[] = [];
  private readonly turns: Turns;
  private turn = 0; // a newer question makes older answers void
  private hears = false;

  constructor(private readonly session: EchoSession, private readonly parts: ChatParts) {
    this.headers = parts.token ? { authorization: `Bearer ${parts.token}` } : {};
    this.turns = new Turns(session, { begun: () => this.cutIn(), ended: (wav) => void this.heard(wav) });
    element<HTMLFormElement>("chat").onsubmit = (event) => {
      event.preventDefault();
      const input = element<HTMLInputElement>("words");
      const text = input.value.trim();
      input.value = "";
      if (text) void this.ask(text);
    };
    element("ear").onclick = () => void this.toggleEar();
  }

  /** Whether somebody is there to talk to. */
  async isPossible(): Promise<boolean> {
    const answer = await fetch("./v1/chat", { headers: this.headers }).catch(() => null);
    if (!answer?.ok) return false;
    const { hears } = (await answer.json()) as { hears: boolean };
    this.hears = hears;
    element("ear").title = hears ? "Talk" : "Let it listen (its script does not know words)";
    return true;
  }

  toggle(): void {
    const box = element("talk");
    box.hidden = !box.hidden;
    if (!box.hidden) element("words").focus();
    else this.turns.stop();
  }

  /** The microphone is wanted elsewhere. */
  stop(): void {
    this.turns.stop();
    this.showEar();
  }

  private async ask(text: string): Promise<void> {
    const turn = ++this.turn;
    this.parts.hush();
    const history = [...this.history];
    this.note({ role: "user", text });
    try {
      const { say } = await this.post<{ say: string }>("./v1/chat", "application/json", JSON.stringify({
        session: this.session.ready?.session ?? "", text, history,
      }));
      if (turn !== this.turn || !say) return;
      this.note({ role: "assistant", text: say });
      const samples = await this.parts.voice(say);
      if (turn === this.turn && samples) await this.parts.say(samples);
    } catch (error) {
      toast((error as Error).message);
    }
  }

  /** The visitor begins to speak: the avatar falls silent, and looks at them. */
  private cutIn(): void {
    this.turn++;
    this.parts.hush();
  }

  private async heard(wav: Blob): Promise<void> {
    if (!this.hears) return;
    try {
      const { text } = await this.post<{ text: string }>("./v1/chat/ears", "audio/wav", wav);
      if (text) await this.ask(text);
    } catch (error) {
      toast((error as Error).message);
    }
  }

  private async toggleEar(): Promise<void> {
    try {
      if (this.turns.isOpen) this.turns.stop();
      else await this.turns.open();
    } catch {
      toast("The browser did not give the microphone. Allow it in the address bar and try again.");
    }
    this.showEar();
  }

  private showEar(): void {
    element("ear").setAttribute("aria-pressed", String(this.turns.isOpen));
  }

  private async post<Answer>(url: string, type: string, body: BodyInit): Promise<Answer> {
    const answer = await fetch(url, { method: "POST", headers: { ...this.headers, "content-type": type }, body });
    const told = (await answer.json()) as Answer & { error?: string };
    if (!answer.ok) throw new Error(told.error ?? `the server answered ${answer.status}`);
    return told;
  }

  private note(saying: Saying): void {
    this.history.push(saying);
    const rows = this.history.slice(-SHOWN).map(({ role, text }) => {
      const row = document.createElement("p");
      row.className = role;
      row.textContent = text;
      return row;
    });
    element("sayings").replaceChildren(...rows);
  }
}
