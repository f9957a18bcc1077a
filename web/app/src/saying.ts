/** Typed text, said by the voice of the server's machine; hidden where it has none. */

import { decodeSound } from "./sources.js";

const element = <Kind extends HTMLElement>(id: string) => document.getElementById(id) as Kind;

export class Saying {
  private readonly headers: Record<string, string>;
  private busy = false;

  /** `say` is told the sound; `fail` what went wrong. */
  constructor(token: string, private readonly rate: () => number, say: (samples: Float32Array) => Promise<void>, fail: (error: Error) => void) {
    this.headers = token ? { authorization: `Bearer ${token}` } : {};
    element<HTMLFormElement>("saying").onsubmit = (event) => {
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

  /** Whether there is a voice. */
  async isPossible(): Promise<boolean> {
    const answer = await fetch("./v1/voice", { headers: this.headers }).catch(() => null);
    return !!answer?.ok && !!((await answer.json()) as { voice: string }).voice;
  }

  toggle(): void {
    const form = element("saying");
    form.hidden = !form.hidden;
    if (!form.hidden) element("text").focus();
  }

  /** The sound of a text. */
  async speak(text: string): Promise<Float32Array> {
    const headers = { ...this.headers, "content-type": "application/json" };
    const answer = await fetch("./v1/voice", { method: "POST", headers, body: JSON.stringify({ text }) });
    if (!answer.ok) throw new Error(((await answer.json()) as { error: string }).error);
    return decodeSound(await answer.arrayBuffer(), this.rate());
  }
}
