/** SVG plots: whiskers for means and strengths, bars for hours. Each has a text alternative. */

import { h, s } from "../dom.js";
import { t } from "../strings.js";
import { signed } from "./table.js";

export interface Whisker {
  readonly label: string;
  /** Index of the colour, from 0. */
  readonly series: number;
  readonly value: number;
  readonly low: number;
  readonly high: number;
}

const [WIDTH, LABEL, ROW, HEAD] = [640, 200, 26, 28];

/** Maps a value to its x position between the labels and the right edge. */
export function scale(domain: readonly [number, number]): (value: number) => number {
  const [low, high] = domain;
  return (value) => LABEL + ((Math.min(Math.max(value, low), high) - low) / (high - low)) * (WIDTH - LABEL - 24);
}

/** A domain with round ends that contains all whiskers and zero. */
export function domainOf(whiskers: readonly Whisker[]): [number, number] {
  const ends = whiskers.flatMap(({ low, high }) => [low, high]).filter(Number.isFinite);
  const reach = Math.max(0.5, ...ends.map(Math.abs));
  const round = Math.ceil(reach * 2) / 2;
  return [-round, round];
}

/** Points with intervals, one per line; `series` names the colours. */
export function whiskers(
  title: string,
  rows: readonly Whisker[],
  domain: readonly [number, number],
  series: readonly string[] = [],
): HTMLElement {
  const x = scale(domain);
  const height = HEAD + rows.length * ROW + 12;
  const ticks = [domain[0], domain[0] / 2, 0, domain[1] / 2, domain[1]];
  const grid = ticks.map((tick) =>
    s(
      "g",
      { class: tick === 0 ? "zero" : "tick" },
      s("line", { x1: x(tick), x2: x(tick), y1: HEAD - 6, y2: height - 4 }),
      s("text", { x: x(tick), y: HEAD - 12, "text-anchor": "middle" }, signed(tick, Number.isInteger(tick) ? 0 : 2)),
    ),
  );
  const lines = rows.map((row, k) => {
    const y = HEAD + k * ROW + ROW / 2;
    return s(
      "g",
      { class: "whisker", style: `color: var(--c${row.series % 6})` },
      s("text", { x: LABEL - 14, y: y + 5, "text-anchor": "end", class: "label" }, row.label),
      s("line", { x1: x(row.low), x2: x(row.high), y1: y, y2: y }),
      s("circle", { cx: x(row.value), cy: y, r: 5 }),
      s("title", {}, `${row.label}: ${signed(row.value)} [${signed(row.low)}, ${signed(row.high)}]`),
    );
  });
  const words = rows
    .map((row) => `${row.label} ${signed(row.value)} [${signed(row.low)}, ${signed(row.high)}]`)
    .join("; ");
  const legend =
    series.length > 1 &&
    h(
      "p",
      { class: "legend" },
      ...series.map((name, k) => h("span", { style: `color: var(--c${k % 6})` }, "● ", h("b", {}, name))),
    );
  return h(
    "figure",
    { class: "plot" },
    h("figcaption", {}, title),
    legend,
    s("svg", { viewBox: `0 0 ${WIDTH} ${height}`, role: "img", "aria-label": `${title}: ${words}` }, ...grid, ...lines),
  );
}

/** One bar per hour, oldest first. */
export function hourBars(counts: readonly number[]): HTMLElement {
  const [width, height, most] = [640, 120, Math.max(1, ...counts)];
  const step = width / Math.max(1, counts.length);
  const bars = counts.map((count, k) => {
    const tall = (count / most) * (height - 34);
    return s(
      "g",
      {},
      s(
        "rect",
        {
          x: k * step + 2,
          y: height - 18 - tall,
          width: step - 4,
          height: Math.max(tall, 1),
          rx: 2,
          class: count ? "bar" : "bar none",
        },
        s("title", {}, String(count)),
      ),
      count > 0 && s("text", { x: (k + 0.5) * step, y: height - 22 - tall, "text-anchor": "middle" }, String(count)),
    );
  });
  const total = counts.reduce((sum, count) => sum + count, 0);
  return h(
    "figure",
    { class: "plot" },
    s(
      "svg",
      { viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": `${t("per_hour")}: ${total}` },
      ...bars,
      s("text", { x: 2, y: height - 3 }, t("hours_ago", { hours: counts.length })),
      s("text", { x: width - 2, y: height - 3, "text-anchor": "end" }, t("now")),
    ),
  );
}
