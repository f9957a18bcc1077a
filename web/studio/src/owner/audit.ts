/** The audit log, newest entry first. */

import type { Audit, Event as Line } from "../api.generated.js";
import { h } from "../dom.js";
import { t } from "../strings.js";
import type { Desk } from "./app.js";
import { section, table, when } from "./table.js";

const PAGE = 200; // entries per request

export async function auditView(desk: Desk): Promise<HTMLElement> {
  return h("main", { class: "owner" }, h("h1", { tabindex: -1 }, t("owner_audit")), await auditTable(desk, ""));
}

/** The log of one study, or of all if `study` is empty. */
export async function auditTable({ api, attempt }: Desk, study: string): Promise<HTMLElement> {
  const lines: Line[] = [];
  const box = h("div", {});
  const more = h(
    "button",
    { class: "button small", type: "button", onclick: () => void attempt(load) },
    t("audit_more"),
  );
  const load = async () => {
    const query = new URLSearchParams(study ? { study } : {});
    const last = lines.at(-1);
    if (last) query.set("before", String(last.id));
    const { events } = await api.get<Audit>(`/api/owner/audit?${query}`);
    lines.push(...events);
    more.hidden = events.length < PAGE;
    box.replaceChildren(
      lines.length
        ? table(
            t("owner_audit"),
            [t("audit_when"), t("audit_who"), t("audit_what"), t("audit_detail")],
            lines.map((line) => [when(line.at), line.actor, line.action, line.detail]),
          )
        : h("p", {}, t("none_yet")),
    );
  };
  await load();
  return section(t("owner_audit"), box, more);
}
