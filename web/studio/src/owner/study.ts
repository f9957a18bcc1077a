/** One study: its header, its tabs and the live progress tab. */

import type { ChangeState, Done, StudyDetail, StudyRow } from "../api.generated.js";
import { ask, h } from "../dom.js";
import { type Key, t, word } from "../strings.js";
import type { Desk } from "./app.js";
import { auditTable } from "./audit.js";
import { invitationsTab } from "./invitations.js";
import { hourBars } from "./plots.js";
import { ratersTab } from "./raters.js";
import { resultsTab } from "./results.js";
import { progress, state } from "./studies.js";
import { meter, section, table } from "./table.js";

const POLL = 4; // seconds
const TABS = ["overview", "invite", "raters", "results", "settings", "audit"] as const;

/** API paths of a study. */
export const path = (id: string, ...more: (string | number)[]) =>
  ["/api/owner/studies", ...[id, ...more].map((part) => encodeURIComponent(part))].join("/");

export async function studyView(desk: Desk, id = "", name = "overview"): Promise<HTMLElement> {
  const tab = TABS.find((known) => known === name) ?? "overview";
  const detail = await desk.api.get<StudyDetail>(path(id));
  const tabs = h(
    "nav",
    { class: "tabs", "aria-label": detail.study.title },
    ...TABS.map((one) =>
      h(
        "a",
        { href: `#/study/${encodeURIComponent(id)}/${one}`, "aria-current": one === tab ? "page" : null },
        t(`tab_${one}` as Key),
      ),
    ),
  );
  const head = h("div", { class: "head" }, h("h1", { tabindex: -1 }, detail.study.title));
  const facts = h("div", { class: "row spread" });
  const drawFacts = (study: StudyRow) =>
    facts.replaceChildren(
      h(
        "p",
        { class: "facts" },
        state(study),
        h("span", {}, word("kind", study.kind)),
        h("span", {}, t("owner_raters", { here: study.raters, of: study.raters_wanted })),
      ),
      actions(desk, study),
    );
  drawFacts(detail.study);
  return h("main", { class: "owner" }, head, facts, tabs, await content(desk, id, tab, detail, drawFacts));
}

async function content(
  desk: Desk,
  id: string,
  tab: (typeof TABS)[number],
  detail: StudyDetail,
  drawFacts: (study: StudyRow) => void,
): Promise<HTMLElement> {
  switch (tab) {
    case "invite":
      return invitationsTab(desk, id);
    case "raters":
      return ratersTab(desk, id);
    case "results":
      return resultsTab(desk, id);
    case "settings":
      return section(t("settings_taken"), h("pre", { tabindex: 0 }, detail.settings));
    case "audit":
      return auditTable(desk, id);
    default:
      return overview(desk, id, detail, drawFacts);
  }
}

/** The live tab, refreshed every few seconds. */
function overview(
  { api, every }: Desk,
  id: string,
  first: StudyDetail,
  drawFacts: (study: StudyRow) => void,
): HTMLElement {
  const box = h("div", { class: "parts" });
  let shown = "";
  const draw = (detail: StudyDetail) => {
    const next = JSON.stringify(detail);
    if (next === shown) return;
    shown = next;
    drawFacts(detail.study);
    const cells = detail.progress.map(({ category, sounds, done, of }) =>
      meter(
        done,
        of,
        `${word("category", category)}: ${t("owner_judgements", { done, of })}, ${t("sounds")}: ${sounds}`,
      ),
    );
    const systems = detail.systems.map(({ name, source, clips, judgements }) => [name, source, clips, judgements]);
    box.replaceChildren(
      section(t("tab_overview"), progress(detail.study), ...cells),
      section(t("per_hour"), hourBars(detail.per_hour)),
      section(t("by_system"), table(t("by_system"), [t("system"), t("source"), t("clips"), t("judgements")], systems)),
    );
  };
  draw(first);
  every(POLL, async () => draw(await api.get<StudyDetail>(path(id))));
  return box;
}

function actions(desk: Desk, study: StudyRow): HTMLElement {
  const change = (to: ChangeState["state"]) => () =>
    void desk.attempt(() => desk.api.post<StudyRow>(path(study.id, "state"), { state: to })).then(reload);
  const buttons: HTMLElement[] = [];
  if (study.state === "open")
    buttons.push(
      h("button", { class: "button small close-study", type: "button", onclick: change("closed") }, t("close_study")),
    );
  if (study.state === "closed")
    buttons.push(
      h("button", { class: "button small open-study", type: "button", onclick: change("open") }, t("open_study")),
    );
  if (study.state === "closed" || study.state === "failed")
    buttons.push(
      h(
        "button",
        { class: "button small danger delete-study", type: "button", onclick: () => void remove(desk, study) },
        t("delete_study"),
      ),
    );
  return h("div", { class: "row" }, ...buttons);
}

async function remove({ api, attempt }: Desk, study: StudyRow): Promise<void> {
  if (!(await ask(t("delete_study_ask", { title: study.title }), t("yes_delete"), t("cancel")))) return;
  if (await attempt(() => api.delete<Done>(path(study.id)))) location.hash = "#/";
}

/** Reloads the current view. */
export function reload(): void {
  dispatchEvent(new HashChangeEvent("hashchange"));
}
