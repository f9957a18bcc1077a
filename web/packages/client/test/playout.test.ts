import { expect, it } from "vitest";
import { Playout, type PlayoutMark } from "../src/playout.js";

const JITTER = 2400;
const CHUNK = 6400;

/** Sample n of the session has the value n, so the output shows which samples were played. */
function ramp(at: number, length: number): Float32Array {
  return Float32Array.from({ length }, (_, i) => at + i);
}

function run(queue: Playout, samples: number, from = 0): { out: number[]; marks: PlayoutMark[] } {
  const out: number[] = [];
  const marks: PlayoutMark[] = [];
  for (let frame = from; frame < from + samples; frame += 128) {
    const block = new Float32Array(128);
    marks.push(...queue.process(block, frame));
    out.push(...block);
  }
  return { out, marks };
}

it("starts at once with a chunk and the jitter buffer, and plays each sample in its place", () => {
  const queue = new Playout(JITTER, CHUNK);
  queue.push(0, ramp(0, CHUNK));
  queue.push(CHUNK, ramp(CHUNK, JITTER));
  const { out, marks } = run(queue, 1280);
  expect(marks).toEqual([{ frame: 0, at: 0, playing: true, underruns: 0 }]);
  expect(out.slice(100, 1280)).toEqual([...ramp(100, 1180)]);
});

it("waits for a longer chunk where the server's are longer", () => {
  const queue = new Playout(JITTER, 9600);
  queue.push(0, ramp(0, 9600 + JITTER - 1));
  expect(run(queue, 1280).marks).toEqual([]);
  queue.push(9600 + JITTER - 1, ramp(9600 + JITTER - 1, 9600));
  expect(run(queue, 1280, 1280).marks).toEqual([{ frame: 1280, at: 0, playing: true, underruns: 0 }]);
});

it("waits for the jitter buffer's time when only one chunk came", () => {
  const queue = new Playout(JITTER, CHUNK);
  expect(run(queue, 1280).marks).toEqual([]);
  queue.push(0, ramp(0, CHUNK));
  const { marks } = run(queue, 3840, 1280);
  expect(marks).toHaveLength(1);
  expect(marks[0]!.frame).toBeGreaterThanOrEqual(1280 + JITTER - 128);
  expect(marks[0]!.frame).toBeLessThanOrEqual(1280 + JITTER);
});

it("stops where sound runs out, to the sample, and goes on there with the buffer filled again", () => {
  const queue = new Playout(JITTER, CHUNK);
  queue.push(0, ramp(0, CHUNK + JITTER));
  const first = run(queue, 12800);
  expect(first.marks.at(-1)).toEqual({ frame: 8800, at: 8800, playing: false, underruns: 1 });
  queue.push(8800, ramp(8800, CHUNK + JITTER));
  const { marks, out } = run(queue, 1280, 12800);
  expect(marks).toEqual([{ frame: 12800, at: 8800, playing: true, underruns: 1 }]);
  expect(out[500]).toBeCloseTo(8800 + 500, 0);
});

it("cuts sound that is there already off the front of what is sent again", () => {
  const queue = new Playout(JITTER, CHUNK);
  queue.push(0, ramp(0, CHUNK));
  queue.push(3200, ramp(3200, CHUNK));
  queue.push(0, ramp(0, 800));
  expect(queue.end).toBe(9600);
  expect(run(queue, 9600).out.slice(48, 9600)).toEqual([...ramp(48, 9552)]);
});

it("flushes what was not heard and fades out without a click", () => {
  const queue = new Playout(JITTER, CHUNK);
  queue.push(0, new Float32Array(20000).fill(0.5));
  run(queue, 1280);
  queue.flush(1280);
  expect(queue.head).toBe(1280);
  const { out } = run(queue, 256, 1280);
  const steps = [0.5, ...out].map((value, i, all) => Math.abs(value - (all[i - 1] ?? 0.5)));
  expect(Math.max(...steps)).toBeLessThan(0.03);
  expect(Math.abs(out[200]!)).toBeLessThan(1e-3);
});

it("plays up to a flush that lies ahead", () => {
  const queue = new Playout(JITTER, CHUNK);
  queue.push(0, ramp(0, 20000));
  run(queue, 1280);
  queue.flush(5000);
  const { marks } = run(queue, 5120, 1280);
  expect(marks).toEqual([{ frame: 5000, at: 5000, playing: false, underruns: 1 }]);
});

it("plays silence over a hole in a running stream", () => {
  const queue = new Playout(0, CHUNK);
  queue.push(0, ramp(0, 1280));
  queue.push(2560, ramp(2560, 1280));
  const { out, marks } = run(queue, 3840);
  expect(marks).toHaveLength(1);
  expect(out[2600]).toBe(2600);
  expect(Math.abs(out[2000]!)).toBe(0);
});

it("tells where it goes on after output frames were left out", () => {
  const queue = new Playout(JITTER, CHUNK);
  queue.push(0, ramp(0, CHUNK + JITTER));
  run(queue, 1280);
  const { out, marks } = run(queue, 1280, 1280 + 384);
  expect(out).toEqual([...ramp(1280, 1280)]); // no sample is skipped
  expect(marks).toEqual([{ frame: 1664, at: 1280, playing: true, underruns: 0 }]);
});

it("knows only whole samples", () => {
  expect(() => new Playout(0, CHUNK).jump(0.5)).toThrow(RangeError);
});
