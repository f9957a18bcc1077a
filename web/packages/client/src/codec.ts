/** Messages to bytes and back: MessagePack on binary frames. Unknown kinds of message are ignored. */

import { decode, encode } from "@msgpack/msgpack";
import type { ClientMessage, ServerMessage } from "./protocol.generated.js";

const KNOWN: ReadonlySet<string> = new Set<ServerMessage["type"]>([
  "ready", "motion", "audio", "flush", "action_status", "state", "stats", "error", "pong",
]);

export class ProtocolError extends Error {
  override readonly name = "ProtocolError";
}

export function encodeMessage(message: ClientMessage): Uint8Array<ArrayBuffer> {
  return encode(message, { ignoreUndefined: true }) as Uint8Array<ArrayBuffer>;
}

/** What the server said; null for a kind of message that this version does not know. */
export function decodeMessage(frame: ArrayBuffer | Uint8Array): ServerMessage | null {
  let value: unknown;
  try {
    value = decode(frame);
  } catch (error) {
    throw new ProtocolError(`this is no message: ${String(error)}`);
  }
  if (typeof value !== "object" || value === null || typeof (value as { type?: unknown }).type !== "string") {
    throw new ProtocolError("a message is a map whose `type` says which");
  }
  return KNOWN.has((value as { type: string }).type) ? (value as ServerMessage) : null;
}

/** s16le bytes as samples in [-1, 1]. */
export function pcmToFloat(pcm: Uint8Array): Float32Array<ArrayBuffer> {
  const view = new DataView(pcm.buffer, pcm.byteOffset, pcm.byteLength);
  const out = new Float32Array(pcm.byteLength >> 1);
  for (let i = 0; i < out.length; i++) out[i] = view.getInt16(i * 2, true) / 32768;
  return out;
}

/** Samples as s16le bytes; louder ones than 1 are clipped. */
export function floatToPcm(samples: Float32Array): Uint8Array<ArrayBuffer> {
  const out = new Uint8Array(samples.length * 2);
  const view = new DataView(out.buffer);
  for (let i = 0; i < samples.length; i++) {
    view.setInt16(i * 2, Math.round(Math.max(-1, Math.min(1, samples[i]!)) * 32767), true);
  }
  return out;
}
