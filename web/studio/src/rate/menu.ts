/** The menu of a rater's page: keys, resume link, leave, delete. */

import { ask, h } from "../dom.js";
import { icon } from "../icons.js";
import { t } from "../strings.js";
import { resumeLink } from "./words.js";

export interface Leaving {
  readonly leave: () => void;
  readonly withdraw: () => void;
}

export function menu(kind: string, resume: string, { leave, withdraw }: Leaving): HTMLElement {
  const box = h(
    "details",
    { class: "menu" },
    h("summary", { class: "tool", "aria-label": t("menu"), title: t("menu") }, icon("menu")),
  );
  const entry = (label: string, className: string, run: () => void) =>
    h(
      "button",
      {
        type: "button",
        class: className,
        onclick: () => {
          box.open = false;
          run();
        },
      },
      label,
    );
  box.append(
    h(
      "div",
      { class: "card entries" },
      entry(t("help"), "keys", () => void showKeys(kind)),
      resume ? resumeLink(resume) : null,
      entry(t("rate_leave"), "leave", leave),
      entry(
        t("rate_withdraw"),
        "danger withdraw",
        () => void ask(t("rate_withdraw_ask"), t("yes_delete"), t("cancel")).then((sure) => sure && withdraw()),
      ),
    ),
  );
  box.addEventListener("keydown", (event) => {
    if (event.key !== "Escape") return;
    box.open = false;
    box.querySelector("summary")?.focus();
  });
  const outside = (event: Event) => {
    if (!box.contains(event.target as Node)) box.open = false;
  };
  box.addEventListener("toggle", () => {
    if (box.open) document.addEventListener("pointerdown", outside);
    else document.removeEventListener("pointerdown", outside);
  });
  return box;
}

/** The dialog that lists the keys. */
export function showKeys(kind: string): void {
  const rows: [string, string][] = [
    [t("key_name_space"), t("key_space")],
    ["R", t("key_again")],
    ["1 2 …", t("key_number")],
  ];
  if (kind === "preference")
    rows.push(["← →", t("key_arrows")], ["A", t("play_all")], ["B", t("key_best")], ["W", t("key_worst")]);
  else rows.push(["← →", t("key_rate")]);
  rows.push(
    [", .", t("key_turn")],
    ["+ −", t("key_zoom")],
    ["V", t("key_view")],
    ["L", t("loop")],
    ["M", t("key_mute")],
    [t("key_name_enter"), t("key_submit")],
  );
  const dialog = h(
    "dialog",
    { class: "card ask", "aria-label": t("help") },
    h("h2", {}, t("help")),
    h(
      "dl",
      { class: "keylist" },
      ...rows.flatMap(([key, what]) => [h("dt", {}, h("kbd", {}, key)), h("dd", {}, what)]),
    ),
    h("form", { method: "dialog", class: "row end" }, h("button", { class: "button primary" }, t("close"))),
  );
  dialog.addEventListener("close", () => dialog.remove());
  document.body.append(dialog);
  dialog.showModal();
}
