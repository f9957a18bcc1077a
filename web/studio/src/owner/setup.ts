/** Sets a study up: the form and its button. */

import type { NewStudy, SetUp, StudyRow } from "../api.generated.js";
import { h } from "../dom.js";
import { t } from "../strings.js";
import type { Desk } from "./app.js";
import { SetupForm } from "./form.js";

export async function setupView({ api, attempt }: Desk): Promise<HTMLElement> {
  const known = await api.get<SetUp>("/api/owner/setup");
  const form = new SetupForm(known);
  const make = h("button", { class: "button primary make", type: "button" }, t("setup_make"));
  make.addEventListener("click", async () => {
    if (make.disabled || !form.isValid()) return;
    make.disabled = true; // a double click must not make two studies
    const body: NewStudy = { settings: form.text };
    await attempt(async () => {
      const study = await api.post<StudyRow>("/api/owner/studies", body);
      location.hash = `#/study/${study.id}/overview`;
    });
    make.disabled = false;
  });
  return h(
    "main",
    { class: "owner" },
    h("h1", { tabindex: -1 }, t("owner_new")),
    form.element,
    h("div", { class: "row end" }, make),
  );
}
