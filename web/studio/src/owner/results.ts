/** Results: scores with intervals, pairs, ranking, agreement, preference pairs, and files for download. */

import type { Mean, PreferenceRow, Results, Strength } from "../api.generated.js";
import { CATEGORIES, QUESTIONS } from "../api.generated.js";
import { h } from "../dom.js";
import { t, word } from "../strings.js";
import type { Desk } from "./app.js";
import { type Whisker, domainOf, whiskers } from "./plots.js";
import { path } from "./study.js";
import { meanText, section, signed, table } from "./table.js";

export async function resultsTab({ api }: Desk, id: string): Promise<HTMLElement> {
  const results = await api.get<Results>(path(id, "results"));
  const { judgements, raters, excluded } = results;
  const parts = [
    section(
      t("tab_results"),
      h("p", {}, judgements ? t("results_summary", { judgements, raters, excluded }) : t("results_none")),
      exports(id, results),
    ),
  ];
  if (results.rows.length) parts.push(scores(results));
  if (results.ranking.length) parts.push(ranking(results.ranking));
  if (results.pairs.length) parts.push(pairs(results));
  if (results.preferences.length) parts.push(preferences(results.preferences));
  if (results.agreement.length) parts.push(agreement(results));
  return h("div", { class: "parts" }, ...parts);
}

function exports(id: string, results: Results): HTMLElement {
  const links = (names: readonly string[]) =>
    names.map((name) => h("a", { class: "button small export", href: path(id, "export", name), download: name }, name));
  return h(
    "div",
    {},
    h(
      "div",
      { class: "row", role: "group", "aria-label": t("export") },
      h("b", {}, t("export")),
      ...links(results.exports),
    ),
    results.plots.length > 0 &&
      h(
        "div",
        { class: "row", role: "group", "aria-label": t("export_plots") },
        h("b", {}, t("export_plots")),
        ...links(results.plots),
      ),
  );
}

/** Questions with answers, in the paper's order. */
function asked(rows: readonly { scores: Record<string, Mean> }[]): string[] {
  return QUESTIONS.filter((question) => rows.some((row) => row.scores[question]));
}

/** Groups in order. Only systems of one group were compared, so only they share a plot. */
function groupsOf(rows: readonly { group: string }[]): string[] {
  return [...new Set(rows.map((row) => row.group))];
}

/** The title of a plot, with the group if there is one. */
function titled(group: string, ...rest: string[]): string {
  return [group, ...rest].filter(Boolean).join(", ");
}

function scores({ rows }: Results): HTMLElement {
  const questions = asked(rows);
  const names = questions.map((question) => word("q", question));
  const plots = groupsOf(rows).flatMap((group) =>
    CATEGORIES.flatMap((category) => {
      const own = rows.filter((row) => row.group === group && row.category === category);
      const points = own.flatMap((row) =>
        questions.flatMap((question, series) => whisker(row.system, series, row.scores[question])),
      );
      return points.length ? [whiskers(titled(group, word("category", category)), points, [-2, 2], names)] : [];
    }),
  );
  const lines = rows.map((row) => [
    row.group,
    row.system,
    word("category", row.category),
    ...questions.map((question) => meanText(row.scores[question])),
    Math.max(...questions.map((question) => row.scores[question]?.count ?? 0)),
  ]);
  const heads = [t("field_group"), t("system"), t("category"), ...names, t("judgements")];
  return section(
    t("scores"),
    h("p", { class: "soft" }, t("scores_note")),
    ...plots,
    table(t("scores"), heads, lines),
    h("p", { class: "soft" }, t("half_raters_note")),
  );
}

function whisker(label: string, series: number, mean: Mean | undefined): Whisker[] {
  if (!mean) return [];
  const half = mean.half ?? 0;
  return [{ label, series, value: mean.mean, low: mean.mean - half, high: mean.mean + half }];
}

function pairs({ pairs: rows }: Results): HTMLElement {
  const questions = asked(rows);
  const lines = rows.map((row) => [
    t("first_against", { first: row.first, second: row.second }),
    word("category", row.category),
    ...questions.map((question) => meanText(row.scores[question])),
  ]);
  return section(
    t("pairs"),
    table(t("pairs"), [t("pairs"), t("category"), ...questions.map((question) => word("q", question))], lines),
  );
}

function ranking(rows: readonly Strength[]): HTMLElement {
  const plots = groupsOf(rows).flatMap((group) =>
    rankingPlots(
      group,
      rows.filter((row) => row.group === group),
    ),
  );
  const lines = rows.map((row) => [
    row.group,
    row.rank,
    row.system,
    word("q", row.question),
    word("category", row.category),
    signed(row.strength),
    `[${signed(row.low)}, ${signed(row.high)}]`,
  ]);
  const heads = ["field_group", "rank", "system", "question", "category", "strength", "interval"] as const;
  return section(
    t("ranking"),
    h("p", { class: "soft" }, t("ranking_note")),
    h("div", { class: "plots" }, ...plots),
    table(
      t("ranking"),
      heads.map((head) => t(head)),
      lines,
    ),
  );
}

/** One result per question, over all categories where available. */
function rankingPlots(group: string, rows: readonly Strength[]): HTMLElement[] {
  const categories = [...new Set(rows.map((row) => row.category))];
  const shown = categories.includes("all") ? ["all"] : categories;
  const questions = QUESTIONS.filter((question) => rows.some((row) => row.question === question));
  return shown.flatMap((category) =>
    questions.map((question, series) => {
      const own = rows.filter((row) => row.question === question && row.category === category);
      const points = own
        .sort((a, b) => a.rank - b.rank)
        .map((row) => ({ ...row, label: `${row.rank}. ${row.system}`, series, value: row.strength }));
      const title = titled(group, word("q", question), word("category", category).toLowerCase());
      return whiskers(title, points, domainOf(points));
    }),
  );
}

function agreement({ agreement: rows }: Results): HTMLElement {
  const lines = rows.map((row) => [
    word("q", row.question),
    word("metric", row.metric),
    row.alpha === null ? t("undefined") : signed(row.alpha),
    row.units,
    row.raters,
  ]);
  return section(
    t("agreement"),
    h("p", { class: "soft" }, t("agreement_note")),
    table(t("agreement"), [t("question"), t("metric"), t("alpha"), t("units"), t("raters")], lines),
  );
}

function preferences(rows: readonly PreferenceRow[]): HTMLElement {
  const kept = rows.filter((row) => row.is_kept).length;
  const number = (candidate: number | null) => (candidate === null ? "–" : candidate + 1);
  const lines = rows.map((row) => [
    row.sound,
    word("category", row.category),
    row.votes,
    row.skips,
    number(row.chosen),
    number(row.rejected),
    row.agreement.toFixed(2),
    row.margin.toFixed(2),
    row.is_kept ? t("yes") : t("no"),
  ]);
  return section(
    t("preferences"),
    h("p", {}, t("preferences_note", { kept, all: rows.length })),
    table(
      t("preferences"),
      [
        t("sound_name"),
        t("category"),
        t("votes"),
        t("skips"),
        t("chosen_candidate"),
        t("rejected_candidate"),
        t("share"),
        t("margin"),
        t("kept"),
      ],
      lines,
    ),
  );
}
