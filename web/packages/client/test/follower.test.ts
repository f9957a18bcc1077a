import { describe, expect, it, vi } from "vitest";
import { encode } from "@msgpack/msgpack";
import { type PipecatClient, RTVIEvent } from "@pipecat-ai/client-js";
import { Room, RoomEvent } from "livekit-client";
import { Follower } from "../src/follower.js";
import { followRoom } from "../src/livekit.js";
import { followBot } from "../src/rtvi.js";
import type { MotionMessage, ReadyMessage } from "../src/protocol.generated.js";

const READY = {
  type: "ready", session: "s", sample_rate: 24000, frame_rate: 30, at: 0, epoch: 0, face: [],
  rig: { names: ["hips"], parents: [-1] },
} as unknown as ReadyMessage;

/** Eight frames; the root's x is the number of the frame since the start. */
function motion(at: number, epoch = 0): MotionMessage {
  const [rotations, root] = [new Int16Array(8 * 4), new Float32Array(8 * 3)];
  for (let k = 0; k < 8; k++) {
    rotations[k * 4] = 32767;
    root[k * 3] = at / 800 + k;
  }
  const bytes = (array: { buffer: ArrayBufferLike }): Uint8Array => new Uint8Array(array.buffer);
  return {
    type: "motion", at, frames: 8, epoch, state: "speech", face: new Uint8Array(0),
    rotations: bytes(rotations), root: bytes(root),
  } as unknown as MotionMessage;
}

describe("Follower", () => {
  it("shows the pose of the sound that is heard, through jitter", () => {
    const follower = new Follower({ delay: 50 });
    follower.take(READY);
    expect(follower.picture(0)).toBeNull();
    for (let chunk = 0; chunk < 20; chunk++) {
      const jitter = chunk % 2 ? 30 : -30;
      follower.take(motion(chunk * 6400), 1000 + (chunk * 8000) / 30 + (chunk ? jitter : 0));
    }
    for (const now of [2050, 3050, 5050]) {
      const frame = ((now - 1050) / 1000) * 30;
      expect(Math.abs(follower.picture(now)!.pose.root[0]! - frame)).toBeLessThan(0.2); // 6 ms of 33
    }
  });

  it("forgets what an interruption made stale, and begins anew after a gap", () => {
    const follower = new Follower({ delay: 0 });
    follower.take(READY);
    follower.take(motion(0), 0);
    follower.take({ type: "flush", at: 3200, epoch: 1, seg: 1, heard: 0 });
    follower.take(motion(6400), 200); // of before the interruption
    expect(follower.picture(250)!.held).toBe(true);
    follower.take(motion(6400, 1), 9000);
    expect(follower.picture(9100)!.at).toBeCloseTo(6400 + 2400, 0);
  });
});

describe("LiveKit", () => {
  it("reads the data track and reliable data", async () => {
    const listeners = new Map<string, (...values: never[]) => void>();
    const follower = followRoom({ on: (event, listener) => listeners.set(event, listener) }, { delay: 0 });
    const take = vi.spyOn(follower, "take");
    listeners.get("dataReceived")!(...([encode(READY), undefined, 0, "echoavatar"] as never[]));
    listeners.get("dataReceived")!(...([encode(READY), undefined, 0, "chat"] as never[]));
    const soon = BigInt(Math.round((performance.timeOrigin + performance.now() + 400) * 1000));
    const frames = [{ payload: encode(motion(0)), userTimestamp: soon }, { payload: encode(motion(6400)), userTimestamp: 7n }];
    const stream = new ReadableStream({
      start(controller) {
        for (const frame of frames) controller.enqueue(frame);
        controller.close();
      },
    });
    const track = { info: { name: "echoavatar.motion" }, subscribe: () => stream };
    listeners.get("dataTrackPublished")!(...([track] as never[]));
    await vi.waitFor(() => expect(take).toHaveBeenCalledTimes(3));
    const [, first, second] = take.mock.calls;
    expect(first![1]! - performance.now()).toBeGreaterThan(200); // the publisher's stamp
    expect(Math.abs(second![1]! - performance.now())).toBeLessThan(200); // a clock of 1970 is not believed
  });
});

describe("RTVI", () => {
  it("unpacks server messages and asks for the rig", () => {
    const listeners = new Map<string, (data: never) => void>();
    const sendClientMessage = vi.fn();
    const on = (event: string, listener: (data: never) => void): unknown => listeners.set(event, listener);
    const follower = followBot({ on, sendClientMessage }, { delay: 0 });
    const base64 = (bytes: Uint8Array): string => btoa(String.fromCharCode(...bytes));
    const sent = motion(0);
    const packed = { ...sent, rotations: base64(sent.rotations), root: base64(sent.root), face: "" };
    listeners.get("serverMessage")!({ type: "echoavatar", message: READY } as never);
    listeners.get("serverMessage")!({ type: "other", message: packed } as never);
    expect(follower.picture(performance.now())).toBeNull();
    listeners.get("serverMessage")!({ type: "echoavatar", message: packed } as never);
    expect(follower.picture(performance.now() + 100)!.pose.root[0]).toBeGreaterThan(1);
    listeners.get("botReady")!(undefined as never);
    expect(sendClientMessage).toHaveBeenCalledWith("echoavatar");
  });
});

describe("their clients", () => {
  it("have what the adapters use", () => {
    const room: Parameters<typeof followRoom>[0] = new Room();
    const listeners = vi.spyOn(room as Room, "on");
    followRoom(room);
    expect(listeners.mock.calls.map(([event]) => event)).toEqual([RoomEvent.DataTrackPublished, RoomEvent.DataReceived]);
    const client: (typeof PipecatClient)["prototype"] extends Parameters<typeof followBot>[0] ? true : false = true;
    expect([client, RTVIEvent.ServerMessage, RTVIEvent.BotReady]).toEqual([true, "serverMessage", "botReady"]);
  });
});
