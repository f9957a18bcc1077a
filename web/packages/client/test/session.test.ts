import { decode, encode } from "@msgpack/msgpack";
import { afterEach, beforeEach, expect, it, vi } from "vitest";
import type { ClientMessage, ReadyMessage, ServerMessage } from "../src/protocol.generated.js";
import { EchoSession } from "../src/session.js";

class FakeSocket {
  static readonly OPEN = 1;
  static all: FakeSocket[] = [];
  readyState = 1;
  bufferedAmount = 0;
  binaryType = "";
  onopen: () => void = () => {};
  onmessage: (event: { data: ArrayBuffer }) => void = () => {};
  onclose: () => void = () => {};
  sent: ClientMessage[] = [];

  constructor(readonly url: string, readonly protocols: string[]) {
    FakeSocket.all.push(this);
  }

  send(frame: Uint8Array): void {
    this.sent.push(decode(frame) as ClientMessage);
  }

  close(): void {
    this.readyState = 3;
    this.onclose();
  }

  say(message: ServerMessage): void {
    this.onmessage({ data: encode(message).slice().buffer });
  }

  of(type: ClientMessage["type"]): ClientMessage[] {
    return this.sent.filter((message) => message.type === type);
  }
}

const READY: ReadyMessage = {
  type: "ready", version: 1, server: "test", session: "public", resume: "key", resumed: false, at: 0, epoch: 0, seg: 0,
  received: 0, sample_rate: 24000, frame_rate: 30, chunk_samples: 6400, face: ["jawOpen"], actions: ["wave"], tracks: [], manner: [],
  rig: { names: ["hips"], parents: [-1], rest: [[0, 1, 0]] }, latency: { algorithm: 267, compute: 1 },
  sound: "pcm", limits: { message_bytes: 1 << 20, inbox_seconds: 600, ahead_seconds: 2, resume_seconds: 30, ping_seconds: 30 },
};

function chunk(at: number, epoch = 0, frames = 8): ServerMessage[] {
  const rotations = new Int16Array(frames * 4).map((_, i) => (i % 4 === 3 ? 32767 : 0));
  const root = Float32Array.from({ length: 3 * frames }, (_, i) => (i % 3 === 0 ? at / 800 + i / 3 : 0));
  const raw = (array: ArrayBufferView) => new Uint8Array(array.buffer);
  return [
    { type: "motion", at, epoch, frames, rotations: raw(rotations), root: raw(root), face: new Uint8Array(frames), state: "idle" },
    { type: "audio", at, epoch, seg: 0, pcm: new Uint8Array(1600 * frames) },
  ];
}

const latest = () => FakeSocket.all.at(-1)!;
let session: EchoSession;

beforeEach(() => {
  vi.useFakeTimers();
  vi.stubGlobal("WebSocket", FakeSocket);
  FakeSocket.all = [];
  session = new EchoSession({ url: "ws://x/v1/stream", playbackWorklet: "" });
  session.connect();
  latest().onopen();
  latest().say(READY);
});

afterEach(() => {
  session.close();
  vi.useRealTimers();
  vi.unstubAllGlobals();
});

function feed(until: number, epoch = 0, from = 0, frames = 8): void {
  for (let at = from; at < until; at += 800 * frames) {
    for (const message of chunk(at, epoch, frames)) latest().say(message);
  }
}

it("says hello in the agreed words", () => {
  expect(latest().protocols).toEqual(["echoavatar.v1.msgpack"]);
  expect(latest().sent[0]).toMatchObject({ type: "hello", versions: [1], role: "source", resume: "", played: 0 });
});

it("asks for an avatar that stays near its place", () => {
  const near = new EchoSession({ url: "ws://x/v1/stream", playbackWorklet: "", body: { leash_m: 0.5 } });
  near.connect();
  latest().onopen();
  expect(latest().sent[0]).toMatchObject({ type: "hello", body: { leash_m: 0.5 } });
  near.close();
});

it("lives on the wall clock before any sound is allowed, and tells how far it is", () => {
  feed(48000);
  vi.advanceTimersByTime(1100);
  const picture = session.picture(performance.now())!;
  expect(picture.at).toBeGreaterThan(20000);
  expect(picture.pose.root[0]).toBeCloseTo(picture.at / 800, 1);
  const played = latest().of("played");
  expect(played.length).toBeGreaterThanOrEqual(4);
  expect(played.at(-1)).toMatchObject({ epoch: 0, underruns: 0 });
});

it("interrupts at the sample heard, shows nothing unheard, and goes on with the new epoch", () => {
  feed(48000);
  vi.advanceTimersByTime(1000);
  session.picture(performance.now());
  session.interrupt();
  const [message] = latest().of("interrupt") as { heard: number }[];
  const heard = message!.heard;
  for (const late of chunk(48000)) latest().say(late);
  vi.advanceTimersByTime(300);
  expect(session.picture(performance.now())!.at).toBeLessThanOrEqual(heard);
  latest().say({ type: "flush", at: heard, epoch: 1, seg: 0, heard: 0 });
  for (const stale of chunk(54400)) latest().say(stale);
  feed(heard + 40000, 1, Math.floor(heard / 6400) * 6400);
  vi.advanceTimersByTime(500);
  const at = session.picture(performance.now())!.at;
  expect(at).toBeGreaterThan(heard);
  expect(at).toBeLessThan(heard + 14000);
  expect(session.player!.played.epoch).toBe(1);
});

it("plays chunks as long as the server says they are, and cuts them anywhere", () => {
  session.close();
  session = new EchoSession({ url: "ws://x/v1/stream", playbackWorklet: "" });
  session.connect();
  latest().onopen();
  latest().say({ ...READY, chunk_samples: 9600, latency: { algorithm: 400, compute: 1 } });
  feed(48000, 0, 0, 12);
  for (let picture = 0; picture < 20; picture++) {
    vi.advanceTimersByTime(50);
    const { pose, at } = session.picture(performance.now()) ?? { pose: null, at: -1 };
    if (pose && at > 0) expect(pose.root[0]).toBeCloseTo(at / 800, 1);
  }
  expect(session.picture(performance.now())!.at).toBeGreaterThan(20000);
  session.interrupt();
  const [message] = latest().of("interrupt") as { heard: number }[];
  const cut = Math.ceil(message!.heard / 800) * 800;
  latest().say({ type: "flush", at: cut, epoch: 1, seg: 0, heard: 0 });
  const left = 12 - ((cut / 800) % 12);
  for (const first of chunk(cut, 1, left)) latest().say(first);
  feed(cut + 40000, 1, cut + 800 * left, 12);
  vi.advanceTimersByTime(500);
  const { at } = session.picture(performance.now())!;
  expect(at).toBeGreaterThan(cut);
  expect(at).toBeLessThan(cut + 14000);
  expect(session.player!.played.underruns).toBe(0);
});

it("comes back with the session's key and sends on from where the server is", () => {
  feed(12800);
  const utterance = session.speak();
  utterance.push(new Float32Array(24000));
  utterance.end();
  session.pump();
  latest().close();
  vi.advanceTimersByTime(600);
  expect(FakeSocket.all).toHaveLength(2);
  latest().onopen();
  expect(latest().sent[0]).toMatchObject({ type: "hello", resume: "key", played: 12800, epoch: 0 });
  latest().say({ ...READY, resumed: true, seg: 1, received: 18000 });
  vi.advanceTimersByTime(200);
  expect(latest().of("audio")[0]).toMatchObject({ seg: 1, start: 18000 });
  expect(latest().of("end")).toHaveLength(1);
});

it("says nothing between hello and ready, and repeats an interruption that the line swallowed", () => {
  feed(48000);
  vi.advanceTimersByTime(1000);
  latest().close();
  session.interrupt();
  vi.advanceTimersByTime(600);
  latest().onopen();
  session.speak().push(new Float32Array(2400));
  vi.advanceTimersByTime(1000);
  expect(latest().sent.map((message) => message.type)).toEqual(["hello"]);
  latest().say({ ...READY, resumed: true });
  expect(latest().of("interrupt")).toHaveLength(1);
});

it("begins anew when the session is gone, and says again what was not heard", () => {
  const utterance = session.speak();
  utterance.push(new Float32Array(24000));
  session.pump();
  latest().close();
  vi.advanceTimersByTime(600);
  latest().onopen();
  latest().say({ type: "error", code: "unknown_session", message: "over", fatal: true, retry_after: 0, place: 0 });
  latest().close();
  vi.advanceTimersByTime(1100);
  latest().onopen();
  expect(latest().sent[0]).toMatchObject({ resume: "", played: 0 });
  latest().say({ ...READY, resume: "other" });
  vi.advanceTimersByTime(200);
  expect(latest().of("audio")[0]).toMatchObject({ seg: 1, start: 0 });
});

it("does not knock again where it was turned away for good", () => {
  latest().say({ type: "error", code: "unauthorized", message: "wrong token", fatal: true, retry_after: 0, place: 0 });
  latest().close();
  vi.advanceTimersByTime(60_000);
  expect(FakeSocket.all).toHaveLength(1);
});

it("acts and hears what became of it", () => {
  const heard: string[] = [];
  session.on("action", ({ id, status }) => heard.push(`${id} ${status}`));
  const id = session.act("wave", { hold: 2 });
  expect(latest().of("action")[0]).toEqual({ type: "action", id, name: "wave", hold: 2 });
  latest().say({ type: "action_status", id, name: "wave", status: "done", at: 0, reason: "", choices: [] });
  expect(heard).toEqual([`${id} done`]);
});
