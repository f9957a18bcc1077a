/** The list of studies. */

import type { StudyList, StudyRow } from "../api.generated.js";
import { h } from "../dom.js";
import { t, word } from "../strings.js";
import type { Desk } from "./app.js";
import { meter, when } from "./table.js";

const POLL = 4; // seconds

export async function listView({ api, every }: Desk): Promise<HTMLElement> {
  const list = h("div", { class: "studies" });
  let shown = "";
  const load = async () => {
    const { studies } = await api.get<StudyList>("/api/owner/studies");
    const next = JSON.stringify(studies);
    if (next === shown) return;
    shown = next;
    list.replaceChildren(...(studies.length ? studies.map(card) : [h("p", {}, t("owner_no_studies"))]));
  };
  await load();
  every(POLL, load);
  return h(
    "main",
    { class: "owner" },
    h(
      "div",
      { class: "row spread" },
      h("h1", { tabindex: -1 }, t("owner_studies")),
      h("a", { class: "button primary", href: "#/new" }, t("owner_new")),
    ),
    list,
  );
}

function card(study: StudyRow): HTMLElement {
  return h(
    "article",
    { class: "card study", "data-study": study.id },
    h("h2", {}, h("a", { href: `#/study/${study.id}/overview` }, study.title)),
    h(
      "p",
      { class: "facts" },
      state(study),
      h("span", {}, word("kind", study.kind)),
      h("span", {}, when(study.created)),
      h("span", {}, t("owner_raters", { here: study.raters, of: study.raters_wanted })),
    ),
    progress(study),
  );
}

/** Progress of making or judging, or the reason why there is none. */
export function progress(study: StudyRow): HTMLElement {
  if (study.problem) return h("p", { class: "problem" }, study.problem);
  if (study.making)
    return meter(
      study.making.done,
      study.making.of,
      t("making", { what: study.making.what, done: study.making.done, of: study.making.of }),
    );
  return meter(
    study.judgements,
    study.judgements_wanted,
    t("owner_judgements", { done: study.judgements, of: study.judgements_wanted }),
  );
}

export function state(study: StudyRow): HTMLElement {
  return h("span", { class: `state ${study.state}` }, word("state", study.state));
}
