/** Progress and quality of each rater; excludes, includes and deletes raters. */

import type { Done, Exclude, RaterRow, Raters } from "../api.generated.js";
import { ask, h } from "../dom.js";
import { t } from "../strings.js";
import type { Desk } from "./app.js";
import { field } from "./inputs.js";
import { path } from "./study.js";
import { section, signed, table, when } from "./table.js";

const POLL = 6; // seconds

export async function ratersTab({ api, attempt, every }: Desk, id: string): Promise<HTMLElement> {
  const box = h("div", {});
  let shown = "";
  const draw = async () => {
    const { raters } = await api.get<Raters>(path(id, "raters"));
    if (JSON.stringify(raters) === shown) return;
    shown = JSON.stringify(raters);
    box.replaceChildren(raters.length ? rows(raters) : h("p", {}, t("none_yet")));
  };
  const exclude = async (rater: RaterRow) => {
    const asked: Exclude = { is_excluded: !rater.is_excluded, reason: "" };
    if (asked.is_excluded) {
      const reason = h("input", { maxlength: 2000 });
      if (
        !(await ask(t("exclude_ask", { id: rater.id }), t("exclude"), t("cancel"), field(t("exclude_reason"), reason)))
      )
        return;
      asked.reason = reason.value;
    }
    await attempt(() => api.post<Done>(path(id, "raters", rater.id, "exclude"), asked));
    await attempt(draw);
  };
  const remove = async (rater: RaterRow) => {
    if (!(await ask(t("delete_rater_ask", { id: rater.id }), t("yes_delete"), t("cancel")))) return;
    await attempt(() => api.delete<Done>(path(id, "raters", rater.id)));
    await attempt(draw);
  };
  const rows = (raters: readonly RaterRow[]) => {
    const heads = [
      t("rater"),
      t("label"),
      t("answered"),
      t("checks"),
      t("skipped"),
      t("median"),
      t("too_fast"),
      t("straight"),
      t("agreement_others"),
      t("last_seen"),
      "",
    ];
    return table(
      t("tab_raters"),
      heads,
      raters.map((rater) =>
        row(
          rater,
          () => void exclude(rater),
          () => void remove(rater),
        ),
      ),
    );
  };
  await draw();
  every(POLL, draw);
  return section(t("tab_raters"), box);
}

function row(rater: RaterRow, exclude: () => void, remove: () => void): (Node | string | number)[] {
  const name = h(
    "span",
    {},
    t("rater_number", { id: rater.id }),
    rater.is_excluded && h("em", { class: "state failed", title: rater.reason }, t("excluded")),
  );
  const buttons = h(
    "div",
    { class: "row tight" },
    h(
      "button",
      { class: "button small exclude", type: "button", onclick: exclude },
      t(rater.is_excluded ? "include" : "exclude"),
    ),
    h(
      "button",
      {
        class: "button small danger delete-rater",
        type: "button",
        onclick: remove,
        "aria-label": t("delete_rater_ask", { id: rater.id }),
      },
      t("delete_rater"),
    ),
  );
  const flag = (text: string, isBad: boolean) =>
    isBad ? h("strong", { class: "flag", title: t("suspicious") }, `${text} ⚠`) : text;
  return [
    name,
    rater.label,
    `${rater.done} / ${rater.of}`,
    flag(t("checks_value", { passed: rater.checks_passed, failed: rater.checks_failed }), rater.checks_failed > 0),
    rater.skipped,
    `${rater.median_seconds.toFixed(1)} s`,
    flag(String(rater.too_fast), rater.too_fast > 0),
    flag(`${Math.round(rater.straight * 100)} %`, rater.done >= 8 && rater.straight > 0.9),
    rater.agreement === null ? "–" : flag(signed(rater.agreement), rater.agreement < 0),
    when(rater.last_seen),
    buttons,
  ];
}
