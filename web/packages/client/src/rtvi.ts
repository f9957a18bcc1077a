/** The avatar of a Pipecat bot: motion from RTVI server messages, as @pipecat-ai/client-js delivers them. */

import { Follower, type FollowerOptions } from "./follower.js";
import type { ServerMessage } from "./protocol.generated.js";

/** What is used of `PipecatClient`. */
export interface ClientLike {
  on(event: never, listener: (data: never) => void): unknown;
  sendClientMessage(type: string, data?: unknown): void;
}

const BYTES = ["rotations", "root", "face", "pcm"]; // base64 in RTVI's JSON

/** Follows the avatar that `EchoAvatarProcessor` sends. Call it before `client.connect`. */
export function followBot(client: ClientLike, options?: FollowerOptions): Follower {
  const follower = new Follower(options);
  client.on("serverMessage" as never, (data: { type?: string; message?: Record<string, unknown> }) => {
    if (data?.type !== "echoavatar" || typeof data.message?.type !== "string") return;
    follower.take(unpacked(data.message) as unknown as ServerMessage);
  });
  client.on("botReady" as never, () => client.sendClientMessage("echoavatar")); // asks for `ready` again
  return follower;
}

function unpacked(message: Record<string, unknown>): Record<string, unknown> {
  const out = { ...message };
  if (out.type === "motion") {
    for (const name of BYTES) if (typeof out[name] === "string") out[name] = bytes(out[name]);
  }
  return out;
}

function bytes(text: string): Uint8Array {
  return Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
}
