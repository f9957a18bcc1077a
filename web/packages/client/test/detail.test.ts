import { expect, test } from "vitest";
import { DetailControl } from "../src/drivers/detail.js";

const play = (control: DetailControl, seconds: number, frames: number) => {
  for (let k = 0; k < frames; k++) control.picture(seconds);
  return control.level;
};

test("it starts with the coarsest level and shows the finest on a quick machine", () => {
  const control = new DetailControl(false);
  expect(control.level).toBe(2);
  expect(play(control, 1 / 60, 60)).toBe(2);
  expect(play(control, 1 / 60, 90)).toBe(0);
});

test("a level that is too slow is left for good", () => {
  const control = new DetailControl(false);
  play(control, 1 / 60, 200);
  expect(play(control, 1 / 20, 30)).toBe(1);
  expect(play(control, 1 / 60, 400)).toBe(1);
  expect(play(control, 1 / 20, 60)).toBe(2);
});

test("a slow machine stays where it is, and a hidden tab is no slow machine", () => {
  expect(play(new DetailControl(false), 1 / 12, 300)).toBe(2);
  const control = new DetailControl(false);
  play(control, 1 / 60, 200);
  expect(play(control, 3, 60)).toBe(0);
});

test("on the processor the coarsest level stays", () => {
  expect(play(new DetailControl(true), 1 / 60, 600)).toBe(2);
});
