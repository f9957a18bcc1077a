/** Tables and small elements that the owners' views share. */

import type { Mean } from "../api.generated.js";
import { h } from "../dom.js";

type Cell = Node | string | number | null | undefined;

/** A table that scrolls sideways on small screens. */
export function table(caption: string, heads: readonly string[], rows: readonly (readonly Cell[])[]): HTMLElement {
  return h(
    "div",
    { class: "table", tabindex: 0, role: "region", "aria-label": caption },
    h(
      "table",
      {},
      h("caption", { class: "unseen" }, caption),
      h("thead", {}, h("tr", {}, ...heads.map((head) => h("th", { scope: "col" }, head)))),
      h("tbody", {}, ...rows.map((row) => h("tr", {}, ...row.map((cell) => h("td", {}, cell ?? ""))))),
    ),
  );
}

export function section(title: string, ...content: (Node | false | null)[]): HTMLElement {
  return h("section", { class: "card part" }, h("h2", {}, title), ...content);
}

/** A progress bar with its numbers as text. */
export function meter(done: number, of: number, label: string): HTMLElement {
  return h(
    "div",
    { class: "meter" },
    h(
      "div",
      {
        class: "track",
        role: "progressbar",
        "aria-valuemin": 0,
        "aria-valuemax": of,
        "aria-valuenow": done,
        "aria-label": label,
      },
      h("i", { style: `--share: ${of ? Math.min(1, done / of) : 0}` }),
    ),
    h("span", {}, label),
  );
}

/** Formats 2026-11-21T08:05:00Z as 2026-11-21 08:05 in the reader's time zone. */
export function when(iso: string): string {
  const at = new Date(iso);
  if (Number.isNaN(at.getTime())) return iso;
  const two = (n: number) => String(n).padStart(2, "0");
  return `${at.getFullYear()}-${two(at.getMonth() + 1)}-${two(at.getDate())} ${two(at.getHours())}:${two(at.getMinutes())}`;
}

/** A signed number with a typographic minus. */
export function signed(value: number, digits = 2): string {
  const text = Math.abs(value).toFixed(digits);
  return Number(text) === 0 ? text : `${value < 0 ? "−" : "+"}${text}`;
}

/** Mean ± half the interval, with the interval over raters in brackets. */
export function meanText(mean: Mean | undefined): string {
  if (!mean) return "";
  const half = mean.half === null ? "" : ` ± ${mean.half.toFixed(2)}`;
  const raters = mean.half_raters === null ? "" : ` (± ${mean.half_raters.toFixed(2)})`;
  return `${signed(mean.mean)}${half}${raters}`;
}
