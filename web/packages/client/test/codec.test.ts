import { readFileSync, readdirSync } from "node:fs";
import { decode } from "@msgpack/msgpack";
import { describe, expect, it } from "vitest";
import { ProtocolError, decodeMessage, encodeMessage, floatToPcm, pcmToFloat } from "../src/codec.js";
import type { ClientMessage, MotionMessage } from "../src/protocol.generated.js";
import { unpackPoses } from "../src/timeline.js";

const folder = new URL("../../../../tests/fixtures/wire/", import.meta.url);
const names = readdirSync(folder).filter((name) => name.endsWith(".bin")).map((name) => name.slice(0, -4));
const BLOBS = new Set(["pcm", "rotations", "root", "face"]);
const SERVER = new Set(["ready", "motion", "flush", "action_status", "state", "stats", "error", "pong"]);

function bytes(name: string): Uint8Array {
  return new Uint8Array(readFileSync(new URL(`${name}.bin`, folder)));
}

/** The JSON form of the message, with its blobs decoded to bytes. */
function twin(name: string): Record<string, unknown> {
  const unpack = (text: string) => new Uint8Array(Buffer.from(text, "base64"));
  return JSON.parse(readFileSync(new URL(`${name}.json`, folder), "utf8"), (key, value) => {
    if (key === "packets") return (value as string[]).map(unpack);
    return BLOBS.has(key) && typeof value === "string" ? unpack(value) : value;
  }) as Record<string, unknown>;
}

const plain = (value: unknown) => JSON.parse(JSON.stringify(value, (_, x) => (x instanceof Uint8Array ? [...x] : x)));

describe("the fixtures that Python wrote", () => {
  it("are there", () => expect(names.length).toBeGreaterThan(15));

  it.each(names)("%s says what its twin says", (name) => {
    expect(plain(decode(bytes(name)))).toEqual(plain(twin(name)));
  });

  it.each(names.filter((name) => SERVER.has(String(twin(name)["type"]))))("%s is a server message", (name) => {
    expect(decodeMessage(bytes(name))?.type).toBe(twin(name)["type"]);
  });

  it.each(names)("%s survives our encoder", (name) => {
    const message = twin(name) as unknown as ClientMessage;
    expect(plain(decode(encodeMessage(message)))).toEqual(plain(message));
  });

  it("unpacks poses as Python does", () => {
    const told = JSON.parse(readFileSync(new URL("motion.decoded.json", folder), "utf8"));
    const motion = decodeMessage(bytes("motion")) as MotionMessage;
    const joints = motion.rotations.length / motion.frames / 8;
    const poses = unpackPoses(motion, joints, motion.face.length / motion.frames);
    expect(poses).toHaveLength(motion.frames);
    poses.forEach((pose, k) => {
      const xyzw = (told.rotations_wxyz ?? told.rotations)[k].flatMap(([w, x, y, z]: number[]) => [x, y, z, w]);
      expectClose(pose.rotations, xyzw);
      expectClose(pose.root, told.root[k]);
      expectClose(pose.face, told.face[k]);
    });
  });
});

function expectClose(got: Float32Array, wanted: number[]): void {
  expect(got).toHaveLength(wanted.length);
  wanted.forEach((value, i) => expect(got[i]).toBeCloseTo(value, 4));
}

it("ignores kinds of message that are not known", () => {
  expect(decodeMessage(encodeMessage({ type: "weather" } as unknown as ClientMessage))).toBeNull();
});

it("refuses what is no message", () => {
  expect(() => decodeMessage(new Uint8Array([0xc1]))).toThrow(ProtocolError);
  expect(() => decodeMessage(encodeMessage(7 as unknown as ClientMessage))).toThrow(ProtocolError);
});

it("turns samples into bytes and back, clipping what is too loud", () => {
  const back = pcmToFloat(floatToPcm(new Float32Array([0, 0.5, -0.5, 2, -2])));
  [0, 0.5, -0.5, 1, -1].forEach((value, i) => expect(back[i]).toBeCloseTo(value, 3));
});
