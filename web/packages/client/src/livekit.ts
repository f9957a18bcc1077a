/** The avatar of a LiveKit room: motion from the plugin's data track, or from reliable data where there are no tracks. */

import { decodeMessage } from "./codec.js";
import { Follower, type FollowerOptions } from "./follower.js";

const MOTION = "echoavatar.motion";
const OTHERS = "echoavatar";
const SKEW_MS = 2000; // a publisher's clock that is further off is not believed

/** What is used of `Room` of livekit-client (2.17 or newer for data tracks). */
export interface RoomLike {
  on(event: string, listener: (...values: never[]) => void): unknown;
}

interface Track {
  readonly info: { readonly name: string };
  subscribe(): ReadableStream<{ payload: Uint8Array; userTimestamp?: bigint }>;
}

/** Follows the avatar that `livekit-plugins-echoavatar` publishes. Call it before `room.connect`. */
export function followRoom(room: RoomLike, options?: FollowerOptions): Follower {
  const follower = new Follower(options);
  const take = (payload: Uint8Array, stamp?: bigint): void => {
    const message = decodeMessage(payload);
    if (message) follower.take(message, due(stamp));
  };
  room.on("dataTrackPublished", (track: Track) => {
    if (track.info.name === MOTION) void read(track, take);
  });
  room.on("dataReceived", (payload: Uint8Array, _from: unknown, _kind: unknown, topic?: string) => {
    if (topic === MOTION || topic === OTHERS) take(payload);
  });
  return follower;
}

async function read(track: Track, take: (payload: Uint8Array, stamp?: bigint) => void): Promise<void> {
  const reader = track.subscribe().getReader();
  for (let next = await reader.read(); !next.done; next = await reader.read()) {
    take(next.value.payload, next.value.userTimestamp);
  }
}

/** Microseconds since 1970 by the publisher's clock, on the clock of performance.now(). */
function due(stamp?: bigint): number {
  const now = performance.now();
  if (stamp === undefined) return now;
  const local = Number(stamp) / 1000 - performance.timeOrigin;
  return Math.abs(local - now) > SKEW_MS ? now : local;
}
