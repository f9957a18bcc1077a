import { expect, test } from "vitest";
import { ResolutionControl } from "../src/drivers/resolution.js";

/** What is shown after so many seconds of a machine that draws no more than `rate` pictures a second. */
function after(control: ResolutionControl, seconds: number, rate: number, isCheapest = true) {
  for (let at = 0; at < seconds; ) {
    const took = control.isSteady ? Math.max(1 / rate, 1 / 15) : 1 / rate;
    control.picture(took, isCheapest);
    at += took;
  }
  const { scale, isSteady, isPoster } = control;
  return { scale, isSteady, isPoster };
}
const full = { scale: 1, isSteady: false, isPoster: false };

test("low quality begins with few pixels, and takes more while pictures come quickly", () => {
  const control = new ResolutionControl(true);
  expect(control.scale).toBe(0.7);
  expect(after(control, 20, 22)).toEqual({ ...full, scale: 0.7 });
  expect(after(control, 20, 40)).toEqual(full);
});

test("triangles, then pictures, then the backdrop are given up before edges", () => {
  const control = new ResolutionControl(false);
  expect(after(control, 12, 12, false)).toEqual({ ...full, scale: 0.7 }); // a cheaper avatar is left
  expect(after(control, 1, 12)).toEqual({ ...full, scale: 0.7, isSteady: true });
  expect(after(control, 1.8, 12)).toEqual({ scale: 0.7, isSteady: true, isPoster: true });
  expect(after(control, 20, 12).scale).toBe(0.4);
});

test("pictures that come in time at 15 a second stay at 15 a second, sharp", () => {
  expect(after(new ResolutionControl(true), 6, 18)).toEqual({ scale: 0.7, isSteady: true, isPoster: false });
});

test("a machine that is free again shows everything again", () => {
  const control = new ResolutionControl(true);
  expect(after(control, 30, 8)).toEqual({ scale: 0.4, isSteady: true, isPoster: true });
  expect(after(control, 900, 60)).toEqual(full);
});

test("what was too much is tried ever more rarely", () => {
  const control = new ResolutionControl(true);
  let tries = 0;
  for (let at = 0, was = false; at < 600; at += 1 / 15) {
    after(control, 1 / 30, 18);
    if (was && !control.isSteady) tries++;
    was = control.isSteady;
  }
  expect(tries).toBeGreaterThan(2);
  expect(tries).toBeLessThan(9);
});

test("a steady rate is kept by leaving out pictures of the display", () => {
  const control = new ResolutionControl(true);
  expect(control.isDue(1 / 60)).toBe(true);
  after(control, 6, 18);
  expect([1, 2, 3, 4].map((pictures) => control.isDue(pictures / 60))).toEqual([false, false, false, true]);
});

test("high quality keeps its resolution at 30 pictures a second", () => {
  const control = new ResolutionControl(false);
  expect(after(control, 10, 30).scale).toBe(1);
  expect(after(control, 10, 20, false).scale).toBe(0.7);
});
