import { expect, test } from "vitest";
import { ResolutionControl } from "../src/resolution.js";

/** The scale after so many seconds at a frame rate. */
function after(control: ResolutionControl, seconds: number, rate: number): number {
  for (let k = 0; k < seconds * rate; k++) control.picture(1 / rate);
  return control.scale;
}

test("low quality begins with few pixels, and takes more while pictures come quickly", () => {
  const control = new ResolutionControl(true);
  expect(control.scale).toBe(0.5);
  expect(after(control, 20, 18)).toBe(0.5);
  expect(after(control, 20, 40)).toBe(1);
  expect(after(control, 20, 12)).toBe(0.4);
});

test("high quality keeps its resolution at 30 pictures a second", () => {
  const control = new ResolutionControl(false);
  expect(after(control, 10, 30)).toBe(1);
  expect(after(control, 10, 20)).toBeLessThan(0.5);
});
