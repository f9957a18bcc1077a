/** Labelled fields that write their value into an object. */

import { h } from "../dom.js";
import { t } from "../strings.js";
import type { NumberField } from "./fields.js";

/** A label with its field. */
export function field(label: string, control: HTMLElement): HTMLLabelElement {
  return h("label", { class: "field" }, h("span", {}, label), control);
}

/** Arranges fields in columns. */
export const fields = (...parts: HTMLElement[]) => h("div", { class: "fields" }, ...parts);
export const option = (value: string, label: string, isChosen: boolean) =>
  h("option", { value, selected: isChosen }, label);

export function text<Name extends string>(
  target: Record<Name, string>,
  name: Name,
  label: string,
  attributes: Record<string, string | number | boolean>,
): HTMLElement {
  const input = h("input", { ...attributes, name, value: target[name], oninput: () => (target[name] = input.value) });
  return field(label, input);
}

export function number<Name extends string>(
  target: Record<Name, number>,
  name: Name,
  label: string,
  min: number,
  step = 1,
  max?: number,
): HTMLElement {
  const input = h("input", {
    type: "number",
    name,
    min,
    max,
    step,
    required: true,
    value: target[name],
    oninput: () => (target[name] = input.valueAsNumber),
  });
  return field(label, input);
}

export function numberField(target: Record<string, number>, { name, label, min, max, step }: NumberField): HTMLElement {
  return number(target, name, t(label), min, step, max);
}
