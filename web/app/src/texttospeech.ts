/** The form for typed text, spoken by the server's voice; hidden if the server has none. */

import type { protocol } from "@echoavatar/client";
import { toggle } from "./panels.js";
import { type Part, decodeSound } from "./sources.js";

const element = <Kind extends HTMLElement>(id: string) => document.getElementById(id) as Kind;

/** What the server says about its voices. */
export interface Voices {
  readonly voice: string;
  readonly voices: readonly string[];
  readonly install: string;
}

interface Line {
  readonly wav: string;
  readonly words: protocol.Word[];
  readonly error?: string;
}

export class TextToSpeech {
  private readonly headers: Record<string, string>;
  private busy = false;

  /** `say` gets the sound, `fail` an error. */
  constructor(token: string, private readonly rate: () => number, say: (parts: AsyncIterable<Part>) => Promise<void>, fail: (error: Error) => void) {
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

  /** Synthesises a text, sentence by sentence. */
  async *speak(text: string): AsyncGenerator<Part> {
    const headers = { ...this.headers, "content-type": "application/json" };
    const answer = await fetch("./v1/voice", { method: "POST", headers, body: JSON.stringify({ text, stream: true }) });
    if (!answer.ok) throw new Error(((await answer.json()) as { error: string }).error);
    for await (const line of lines(answer.body!)) {
      const { wav, words, error } = JSON.parse(line) as Line;
      if (error) throw new Error(error);
      const bytes = Uint8Array.from(atob(wav), (letter) => letter.charCodeAt(0));
      yield { samples: await decodeSound(bytes.buffer, this.rate()), words };
    }
  }
}

async function* lines(body: ReadableStream<Uint8Array>): AsyncGenerator<string> {
  const reader = body.pipeThrough(new TextDecoderStream() as ReadableWritablePair<string, Uint8Array>).getReader();
  let rest = "";
  for (;;) {
    const { done, value } = await reader.read();
    if (done) return;
    const whole = (rest + value).split("\n");
    rest = whole.pop()!;
    yield* whole;
  }
}
