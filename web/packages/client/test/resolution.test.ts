import { expect, test } from "vitest";
import { ResolutionControl } from "../src/drivers/resolution.js";

/** The scale after so many seconds at a frame rate. */
function after(control: ResolutionControl, seconds: number, rate: number): number {
  for (let k = 0; k < seconds * rate; k++) control.picture(1 / rate);
  return control.scale;
}

test("low quality begins with few pixels, and takes more while pictures come quickly", () => {
  const control = new ResolutionControl(true);
  expect(control.scale).toBe(0.7);
  expect(after(control, 20, 18)).toBe(0.7);
  expect(after(control, 20, 40)).toBe(1);
  expect(after(control, 20, 12)).toBe(0.4);
});

test("edges stay smooth while a cheaper avatar is left or 15 pictures a second are drawn", () => {
  const control = new ResolutionControl(false);
  for (let k = 0; k < 120; k++) control.picture(1 / 8, false);
  expect(control.scale).toBe(0.7);
  expect(after(new ResolutionControl(false), 20, 16)).toBe(0.7);
  expect(after(control, 20, 8)).toBe(0.4);
  expect(after(control, 20, 60)).toBe(1);
});

test("high quality keeps its resolution at 30 pictures a second", () => {
  const control = new ResolutionControl(false);
  expect(after(control, 10, 30)).toBe(1);
  expect(after(control, 10, 20)).toBe(0.7);
});
