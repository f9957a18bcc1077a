import { expect, it } from "vitest";
import { PlaybackClock, outputFrame } from "../src/clock.js";
import { mixamoName } from "../src/drivers/mixamo.js";
import { Inertia } from "../src/inertia.js";
import { SyncMeter } from "../src/metrics.js";
import { makePose } from "../src/pose.js";
import type { ClientMessage } from "../src/protocol.generated.js";
import { difference, slerp, turn } from "../src/quaternion.js";
import { Resampler } from "../src/resample.js";
import { Utterance } from "../src/utterance.js";

it("slerp takes the shorter arc, at even speed", () => {
  const a = new Float32Array([0, 0, 0, 1]);
  const b = new Float32Array([0, -Math.sin(0.6), 0, -Math.cos(0.6)]); // 1.2 rad about Y, opposite sign
  const out = new Float32Array(4);
  for (const t of [0, 0.25, 0.5, 1]) {
    slerp(a, 0, b, 0, t, out, 0);
    expect(2 * Math.atan2(out[1]!, out[3]!)).toBeCloseTo(1.2 * t, 5);
  }
});

it("difference and turn undo each other", () => {
  const a = new Float32Array([0.5, -0.5, 0.5, 0.5]);
  const b = new Float32Array([0.1, 0.2, -0.3, Math.sqrt(1 - 0.14)]);
  const v = new Float32Array(3);
  difference(a, 0, b, 0, v, 0);
  turn(b, 0, v, 0, 1);
  b.forEach((value, i) => expect(Math.abs(value - a[i]!)).toBeLessThan(1e-5));
});

it("a jump is joined without a step and forgotten after its time", () => {
  const inertia = new Inertia(1, 1, 0.2);
  const pose = makePose(1, 1);
  inertia.apply(pose, 0.016, false);
  let last = 0;
  let fastest = 0;
  for (let i = 0; i < 30; i++) {
    Object.assign(pose, makePose(1, 1));
    pose.rotations.set([0, Math.sin(0.5), 0, Math.cos(0.5)]);
    pose.root[0] = 1;
    pose.face[0] = 1;
    inertia.apply(pose, 1 / 60, i === 0);
    const angle = 2 * Math.atan2(pose.rotations[1]!, pose.rotations[3]!);
    fastest = Math.max(fastest, Math.abs(angle - last) * 60);
    last = angle;
    if (i === 0) expect(pose.root[0]).toBeLessThan(0.01);
  }
  expect(last).toBeCloseTo(1, 5);
  expect(pose.face[0]).toBeCloseTo(1, 5);
  expect(fastest).toBeLessThan(1 * 1.9 / 0.2);
});

it.each([4, 5.5, 1])("a display of %d pictures a second, where each leaps, does not stand still", (rate) => {
  const inertia = new Inertia(1, 1, 0.2);
  const pose = makePose(1, 1);
  for (let i = 0; i < 8; i++) {
    Object.assign(pose, makePose(1, 1));
    pose.root[0] = i;
    inertia.apply(pose, 1 / rate, i > 0);
    expect(i - pose.root[0]!).toBeLessThan(0.2);
  }
});

it("the clock maps frames to samples, through stops", () => {
  const clock = new PlaybackClock();
  expect(clock.at(5)).toBeNull();
  clock.mark({ frame: 1000, at: 0, playing: true, underruns: 0 });
  clock.mark({ frame: 5000, at: 4000, playing: false, underruns: 1 });
  clock.mark({ frame: 9000, at: 4000, playing: true, underruns: 1 });
  expect([0, 1000, 3000, 5000, 8000, 9500].map((frame) => clock.at(frame))).toEqual([0, 0, 2000, 4000, 4000, 4500]);
  expect(clock.playingAt(6000)).toBe(false);
  expect(clock.underruns).toBe(1);
});

it("the meter sums up", () => {
  const meter = new SyncMeter(24000);
  for (let i = 1; i <= 100; i++) meter.add(i * 24, 0, i > 90);
  expect(meter.summary()).toMatchObject({ pictures: 100, p99_ms: 100, max_ms: 100, held: 10 });
  expect(meter.summary().mean_ms).toBeCloseTo(50.5, 3);
});

it.each([[48000, 24000], [44100, 24000], [16000, 24000]])("resamples %i to %i Hz in any cut", (from, to) => {
  const tone = (rate: number, n: number) => Float32Array.from({ length: n }, (_, i) => Math.sin((2 * Math.PI * 440 * i) / rate));
  const input = tone(from, from / 2);
  const resampler = new Resampler(from, to);
  const out: number[] = [];
  for (let i = 0, size = 1; i < input.length; i += size, size = (size * 7) % 401 || 128) {
    out.push(...resampler.push(input.subarray(i, i + size)));
  }
  const wanted = tone(to, out.length);
  expect(out.length).toBeGreaterThan(to / 2 - 100);
  const worst = Math.max(...out.slice(100, -100).map((x, i) => Math.abs(x - wanted[i + 100]!)));
  expect(worst).toBeLessThan(2e-3);
});

it("the resampler keeps out what the lower rate cannot hold", () => {
  const resampler = new Resampler(48000, 24000);
  const high = Float32Array.from({ length: 9600 }, (_, i) => Math.sin((2 * Math.PI * 16000 * i) / 48000));
  const out = resampler.push(high).slice(200);
  expect(Math.max(...out.map(Math.abs))).toBeLessThan(0.02);
});

it("an utterance goes out in order, in parts, ends once, and goes on after a break", () => {
  const sent: ClientMessage[] = [];
  const utterance = new Utterance(3, "avatar", 24000);
  utterance.push(new Float32Array(30000));
  utterance.end();
  utterance.pump((message) => (sent.push(message), true));
  expect(sent.map((message) => (message.type === "audio" ? message.start : message.type))).toEqual([0, 12000, 24000, "end"]);
  expect(utterance.done).toBe(true);
  utterance.resume(20000);
  sent.length = 0;
  utterance.pump((message) => (sent.push(message), true));
  expect(sent[0]).toMatchObject({ type: "audio", seg: 3, start: 20000 });
  utterance.restart(25000);
  sent.length = 0;
  utterance.pump((message) => (sent.push(message), true));
  expect(sent[0]).toMatchObject({ start: 0 });
  expect((sent[0] as { pcm: Uint8Array }).pcm).toHaveLength(10000);
});

it("knows bones by their other names", () => {
  expect(mixamoName("leftIndexProximal")).toBe("LeftHandIndex1");
  expect(mixamoName("rightThumbMetacarpal")).toBe("RightHandThumb1");
  expect(mixamoName("rightThumbProximal")).toBe("RightHandThumb2");
  expect(mixamoName("leftLittleDistal")).toBe("LeftHandPinky3");
  expect(mixamoName("leftUpperLeg")).toBe("LeftUpLeg");
  expect(mixamoName("leftEye")).toBe("");
});

it("believes the device, but hears nothing that was not rendered", () => {
  const now = performance.now();
  const context = (contextTime: number) => ({
    currentTime: 10, outputLatency: 0.05, baseLatency: 0.01, sampleRate: 24000, state: "running",
    getOutputTimestamp: () => ({ contextTime, performanceTime: now }),
  }) as unknown as AudioContext;
  const seconds = (stamp: number, ahead = 0) => outputFrame(context(stamp), performance.now() + ahead) / 24000;
  expect(seconds(9.9)).toBeCloseTo(9.9, 1);
  expect(seconds(9.9, 100)).toBeCloseTo(10, 1);
  expect(seconds(10.2)).toBeCloseTo(10, 3);
  expect(seconds(0)).toBeCloseTo(9.95, 2);
});
