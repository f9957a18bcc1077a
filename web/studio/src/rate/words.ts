/** Text pages: missing invitation, consent, finished, withdrawn. */

import type { Joined } from "../api.generated.js";
import { h, paragraphs, show } from "../dom.js";
import { t } from "../strings.js";

/** A page with a heading, text and buttons. */
export function showWords(title: string, body: readonly (Node | string)[], ...buttons: Node[]): void {
  const parts = body.flatMap((part) => (typeof part === "string" ? paragraphs(part) : [part]));
  show(
    h(
      "main",
      { class: "words card" },
      h("h1", { tabindex: -1 }, title),
      ...parts,
      buttons.length > 0 && h("div", { class: "row" }, ...buttons),
    ),
  );
}

export function showConsent({ study }: Joined, resume: string, answer: (isAgreed: boolean) => void): void {
  const buttons: HTMLButtonElement[] = [];
  const button = (label: string, kind: string, isAgreed: boolean) => {
    const made = h(
      "button",
      {
        class: `button ${kind}`,
        type: "button",
        onclick: () => {
          for (const each of buttons) each.disabled = true; // ignore further clicks
          answer(isAgreed);
        },
      },
      label,
    );
    buttons.push(made);
    return made;
  };
  showWords(
    study.title,
    [
      ...paragraphs(study.intro),
      h("h2", {}, t("rate_consent_title")),
      ...paragraphs(study.consent),
      ...(resume ? [resumeLink(resume)] : []),
    ],
    button(t("rate_agree"), "primary agree", true),
    button(t("rate_disagree"), "quiet disagree", false),
  );
}

/** The rater's personal link, to resume later. */
export function resumeLink(link: string): HTMLElement {
  const field = h("input", {
    type: "text",
    readonly: true,
    value: link,
    "aria-label": t("rate_resume"),
    onfocus: (event) => (event.target as HTMLInputElement).select(),
  });
  const copy = h(
    "button",
    {
      class: "button small",
      type: "button",
      onclick: () => {
        field.select();
        void navigator.clipboard?.writeText(link).then(
          () => (copy.textContent = t("copied")),
          () => undefined,
        );
      },
    },
    t("copy"),
  );
  return h("div", { class: "resume" }, h("p", {}, t("rate_resume")), h("div", { class: "row" }, field, copy));
}
