/** The form for typed text, spoken by the server's voice; hidden if the server has none. */

import { type Part, spoken } from "@echoavatar/client";
import { toggle } from "./panels.js";

const element = <Kind extends HTMLElement>(id: string) => document.getElementById(id) as Kind;

/** What the server says about its voices. */
export interface Voices {
  readonly voice: string;
  readonly voices: readonly string[];
  readonly install: string;
}

export class TextToSpeech {
  private readonly headers: Record<string, string>;
  private busy = false;

  /** `say` gets the sound, `fail` an error. */
  constructor(private readonly token: string, private readonly rate: () => number, say: (parts: AsyncIterable<Part>) => Promise<void>, fail: (error: Error) => void) {
    this.headers = token ? { authorization: `Bearer ${token}` } : {};
    element<HTMLFormElement>("typed").onsubmit = (event) => {
      event.preventDefault();
      const input = element<HTMLInputElement>("text");
      const text = input.value.trim();
      if (!text || this.busy) return;
      this.busy = true;
      say(this.speak(text))
        .then(() => (input.value = ""), fail)
        .finally(() => (this.busy = false));
    };
  }

  /** The server's voices; null if it does not answer. */
  async voices(): Promise<Voices | null> {
    const answer = await fetch("./v1/voice", { headers: this.headers }).catch(() => null);
    return answer?.ok ? ((await answer.json()) as Voices) : null;
  }

  toggle(): void {
    if (toggle("typed")) element("text").focus();
  }

  speak(text: string): AsyncGenerator<Part> {
    return spoken(text, "./", this.rate(), this.token);
  }
}
