/** The chat box: sends typed or spoken text to the server's companion; the avatar speaks and acts the answer. */

import type { EchoSession, Part } from "@echoavatar/client";
import { toast } from "./notices.js";
import { toggle } from "./panels.js";
import { showLevel } from "./sources.js";
import { Turns } from "./turns.js";

const element = <Kind extends HTMLElement>(id: string) => document.getElementById(id) as Kind;
const SHOWN = 4; // messages in view

interface Message {
  readonly role: "user" | "assistant";
  readonly text: string;
}

export interface ChatParts {
  readonly token: string;
  /** Synthesises speech; null if the server has no voice. */
  readonly voice: (text: string) => Promise<AsyncIterable<Part> | null>;
  /** Makes the avatar speak; resolves when all sound was pushed. */
  readonly say: (parts: AsyncIterable<Part>) => Promise<void>;
  /** Interrupts the avatar's speech. */
  readonly stopSpeech: () => void;
}

export class Chat {
  private readonly headers: Record<string, string>;
  private readonly history: Message[] = [];
  private readonly turns: Turns;
  private turn = 0; // answers to older turns are dropped
  private hears = false;

  constructor(private readonly session: EchoSession, private readonly parts: ChatParts) {
    this.headers = parts.token ? { authorization: `Bearer ${parts.token}` } : {};
    this.turns = new Turns(session, { begun: () => this.interrupt(), ended: (wav) => void this.heard(wav), block: showLevel(element("microphone")) });
    element<HTMLFormElement>("chat").onsubmit = (event) => {
      event.preventDefault();
      const input = element<HTMLInputElement>("words");
      const text = input.value.trim();
      input.value = "";
      if (text) void this.ask(text);
    };
    element("microphone").onclick = () => void this.toggleMicrophone();
  }

  /** Whether the server has a companion. */
  async isPossible(): Promise<boolean> {
    const answer = await fetch("./v1/chat", { headers: this.headers }).catch(() => null);
    if (!answer?.ok) return false;
    const { name, where, hears, install } = (await answer.json()) as { name: string; where: string; hears: string; install: string };
    this.hears = !!hears;
    element("microphone").title = hears ? "Talk" : "Let it listen (it does not know words)";
    element("companion").textContent = name === "script"
      ? "A script answers. For a language model start Ollama, LM Studio, vLLM or llama.cpp on the server's machine."
      : `${name} answers${where ? ` (${where})` : ""}.`;
    if (!hears) element("companion").textContent += ` To be understood by voice: ${install}`;
    return true;
  }

  toggle(): void {
    if (toggle("talk")) element("words").focus();
    else this.stop();
  }

  /** Releases the microphone for another use. */
  stop(): void {
    this.turns.stop();
    this.showMicrophone();
  }

  private async ask(text: string): Promise<void> {
    const turn = ++this.turn;
    this.parts.stopSpeech();
    const history = [...this.history];
    this.note({ role: "user", text });
    try {
      const { say } = await this.post<{ say: string }>("./v1/chat", "application/json", JSON.stringify({
        session: this.session.ready?.session ?? "", text, history,
      }));
      if (turn !== this.turn || !say) return;
      this.note({ role: "assistant", text: say });
      const spoken = await this.parts.voice(say);
      if (turn === this.turn && spoken) await this.parts.say(spoken);
    } catch (error) {
      toast((error as Error).message);
    }
  }

  /** Interrupts the avatar when the visitor begins to speak. */
  private interrupt(): void {
    this.turn++;
    this.parts.stopSpeech();
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

  private async toggleMicrophone(): Promise<void> {
    try {
      if (this.turns.isOpen) this.turns.stop();
      else await this.turns.open();
    } catch {
      toast("The browser did not give the microphone. Allow it in the address bar and try again.");
    }
    this.showMicrophone();
  }

  private showMicrophone(): void {
    if (!this.turns.isOpen) element("microphone").style.removeProperty("--level");
    element("microphone").setAttribute("aria-pressed", String(this.turns.isOpen));
  }

  private async post<Answer>(url: string, type: string, body: BodyInit): Promise<Answer> {
    const answer = await fetch(url, { method: "POST", headers: { ...this.headers, "content-type": type }, body });
    const told = (await answer.json()) as Answer & { error?: string };
    if (!answer.ok) throw new Error(told.error ?? `the server answered ${answer.status}`);
    return told;
  }

  private note(message: Message): void {
    this.history.push(message);
    const rows = this.history.slice(-SHOWN).map(({ role, text }) => {
      const row = document.createElement("p");
      row.className = role;
      row.textContent = text;
      return row;
    });
    element("messages").replaceChildren(...rows);
  }
}
