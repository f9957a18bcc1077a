/** Text, said by the server's voice. */

import type { Word } from "./protocol.generated.js";
import { type Part, decodeSound } from "./sound.js";

interface Line {
  readonly wav: string;
  readonly words: Word[];
  readonly error?: string;
}

/** Has a server say a text, sentence by sentence, at `rate`; throws what the server cannot say. `server` ends with a slash. */
export async function* spoken(text: string, server: string, rate: number, token = ""): AsyncGenerator<Part> {
  const headers: Record<string, string> = { "content-type": "application/json" };
  if (token) headers["authorization"] = `Bearer ${token}`;
  const answer = await fetch(`${server}v1/voice`, { method: "POST", headers, body: JSON.stringify({ text, stream: true }) });
  if (!answer.ok) throw new Error(((await answer.json()) as { error: string }).error);
  for await (const line of lines(answer.body!)) {
    const { wav, words, error } = JSON.parse(line) as Line;
    if (error) throw new Error(error);
    const bytes = Uint8Array.from(atob(wav), (letter) => letter.charCodeAt(0));
    yield { samples: await decodeSound(bytes.buffer, rate), words };
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
