/** Encodes and decodes messages: MessagePack in binary frames. Unknown message types are ignored. */

import { decode, encode } from "@msgpack/msgpack";
import type { ClientMessage, ServerMessage } from "./protocol.generated.js";

const KNOWN: ReadonlySet<string> = new Set<ServerMessage["type"]>([
  "ready", "motion", "audio", "opus", "flush", "action_status", "state", "stats", "error", "pong",
]);

export class ProtocolError extends Error {
  override readonly name = "ProtocolError";
}

export function encodeMessage(message: ClientMessage): Uint8Array<ArrayBuffer> {
  return encode(message, { ignoreUndefined: true }) as Uint8Array<ArrayBuffer>;
}

/** Decodes a message of the server; null for a message type that this version does not know. */
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

/** Converts s16le bytes to samples in [-1, 1]. */
export function pcmToFloat(pcm: Uint8Array): Float32Array<ArrayBuffer> {
  const view = new DataView(pcm.buffer, pcm.byteOffset, pcm.byteLength);
  const out = new Float32Array(pcm.byteLength >> 1);
  for (let i = 0; i < out.length; i++) out[i] = view.getInt16(i * 2, true) / 32768;
  return out;
}

/** Converts samples to s16le bytes; values outside [-1, 1] are clipped. */
export function floatToPcm(samples: Float32Array): Uint8Array<ArrayBuffer> {
  const out = new Uint8Array(samples.length * 2);
  const view = new DataView(out.buffer);
  for (let i = 0; i < samples.length; i++) {
    view.setInt16(i * 2, Math.round(Math.max(-1, Math.min(1, samples[i]!)) * 32767), true);
  }
  return out;
}
