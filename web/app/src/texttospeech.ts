/** The form for typed text, spoken by the server's voice; hidden if the server has none. */

import { toggle } from "./panels.js";
import { decodeSound } from "./sources.js";

const element = <Kind extends HTMLElement>(id: string) => document.getElementById(id) as Kind;

export class TextToSpeech {
  private readonly headers: Record<string, string>;
  private busy = false;

  /** `say` gets the sound, `fail` an error. */
  constructor(token: string, private readonly rate: () => number, say: (samples: Float32Array) => Promise<void>, fail: (error: Error) => void) {
    this.headers = token ? { authorization: `Bearer ${token}` } : {};
    element<HTMLFormElement>("typed").onsubmit = (event) => {
      event.preventDefault();
      const input = element<HTMLInputElement>("text");
      const text = input.value.trim();
      if (!text || this.busy) return;
      this.busy = true;
      this.speak(text)
        .then(say)
        .then(() => (input.value = ""), fail)
        .finally(() => (this.busy = false));
    };
  }

  /** Whether the server has a voice. */
  async isPossible(): Promise<boolean> {
    const answer = await fetch("./v1/voice", { headers: this.headers }).catch(() => null);
    return !!answer?.ok && !!((await answer.json()) as { voice: string }).voice;
  }

  toggle(): void {
    if (toggle("typed")) element("text").focus();
  }

  /** Synthesises a text. */
  async speak(text: string): Promise<Float32Array> {
    const headers = { ...this.headers, "content-type": "application/json" };
    const answer = await fetch("./v1/voice", { method: "POST", headers, body: JSON.stringify({ text }) });
    if (!answer.ok) throw new Error(((await answer.json()) as { error: string }).error);
    return decodeSound(await answer.arrayBuffer(), this.rate());
  }
}
