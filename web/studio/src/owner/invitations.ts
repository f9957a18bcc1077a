/** Makes invitation links, shown once, and lists the earlier ones. */

import type { Done, InvitationRow, Invitations, Invite, Invited } from "../api.generated.js";
import { ask, h } from "../dom.js";
import { t } from "../strings.js";
import type { Desk } from "./app.js";
import { field } from "./inputs.js";
import { path } from "./study.js";
import { section, table, when } from "./table.js";

export async function invitationsTab(desk: Desk, id: string): Promise<HTMLElement> {
  const { api, attempt } = desk;
  const made = h("div", { class: "made" });
  const rows = h("div", {});
  const draw = async () => {
    const { invitations } = await api.get<Invitations>(path(id, "invitations"));
    rows.replaceChildren(invitations.length ? list(invitations, revoke) : h("p", {}, t("none_yet")));
  };
  const revoke = async (row: InvitationRow) => {
    if (await ask(t("invite_revoke_ask"), t("invite_revoke"), t("cancel"))) {
      await attempt(() => api.delete<Done>(path(id, "invitations", row.id)));
      await attempt(draw);
    }
  };
  const count = h("input", { type: "number", min: 1, max: 500, value: 1, required: true });
  const kind = h(
    "select",
    {},
    h("option", { value: "personal" }, t("invite_personal")),
    h("option", { value: "open" }, t("invite_open")),
  );
  const label = h("input", { maxlength: 80, placeholder: t("invite_label_hint") });
  const button = h("button", { class: "button primary" }, t("invite_make"));
  const form = h(
    "form",
    { class: "fields" },
    field(t("invite_kind"), kind),
    field(t("invite_count"), count),
    field(t("invite_label"), label),
    button,
  );
  form.addEventListener("submit", async (event) => {
    event.preventDefault();
    if (button.disabled) return;
    button.disabled = true; // a double click must not make links twice
    const asked: Invite = { count: count.valueAsNumber, is_open: kind.value === "open", label: label.value };
    await attempt(async () => {
      const { links } = await api.post<Invited>(path(id, "invitations"), asked);
      made.replaceChildren(links_(links.map(({ url }) => url)));
      await draw();
    });
    button.disabled = false;
  });
  await draw();
  return h(
    "div",
    { class: "parts" },
    section(t("invite_make"), h("p", { class: "soft" }, t("invite_explain")), form, made),
    section(t("tab_invite"), rows),
  );
}

function list(invitations: readonly InvitationRow[], revoke: (row: InvitationRow) => Promise<void>): HTMLElement {
  const rows = invitations.map((row) => [
    row.label || `#${row.id}`,
    row.is_open ? t("invite_open") : t("invite_personal"),
    t("invite_seats", { taken: row.taken, seats: row.seats }),
    when(row.created),
    row.is_revoked
      ? t("invite_revoked")
      : h("button", { class: "button small", type: "button", onclick: () => void revoke(row) }, t("invite_revoke")),
  ]);
  return table(t("tab_invite"), [t("label"), t("invite_kind"), t("seats"), t("created"), ""], rows);
}

function links_(urls: readonly string[]): HTMLElement {
  const text = h("textarea", {
    readonly: true,
    rows: Math.min(10, urls.length + 1),
    "aria-label": t("link"),
    class: "links",
    spellcheck: "false",
  });
  text.value = urls.join("\n");
  const copy = h(
    "button",
    {
      class: "button small",
      type: "button",
      onclick: () => {
        text.select();
        void navigator.clipboard?.writeText(text.value).then(
          () => (copy.textContent = t("copied")),
          () => undefined,
        );
      },
    },
    t("copy_all"),
  );
  return h("div", { class: "once" }, h("p", {}, t("invite_once")), text, copy);
}
