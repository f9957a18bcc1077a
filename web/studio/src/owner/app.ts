/** Sign-in and the owners' views. The URL fragment selects the view, so that back and reload work. */

import { Api, Refused } from "../api.js";
import type { Done, OwnerSession } from "../api.generated.js";
import { h, note, show } from "../dom.js";
import { explain } from "../explain.js";
import { t } from "../strings.js";
import { auditView } from "./audit.js";
import { setupView } from "./setup.js";
import { listView } from "./studies.js";
import { studyView } from "./study.js";

/** What a view gets; `every` repeats a function while the view is shown. */
export interface Desk {
  readonly api: Api;
  every(seconds: number, work: () => Promise<void>): void;
  /** Runs a request and shows a refusal; false if it was refused. */
  attempt(work: () => Promise<unknown>): Promise<boolean>;
}

export type View = (desk: Desk, ...names: string[]) => Promise<HTMLElement>;

const SIGNED_IN = "echoavatar.owner.signed_in";

/** Whether this browser signed in and has not been turned away since. Who never did is not asked for a session. */
function maySessionLive(): boolean {
  try {
    return localStorage.getItem(SIGNED_IN) !== null;
  } catch {
    return true; // storage is disabled: ask the server
  }
}

function noteSession(isOpen: boolean): void {
  try {
    if (isOpen) localStorage.setItem(SIGNED_IN, "1");
    else localStorage.removeItem(SIGNED_IN);
  } catch {
    // storage is disabled: every visit asks the server
  }
}

export class OwnerApp {
  private readonly api = new Api();
  private timers: ReturnType<typeof setInterval>[] = [];
  private name = "";
  private turn = 0;

  constructor() {
    addEventListener("hashchange", () => this.name && void this.go());
    addEventListener("pageshow", (event) => event.persisted && void this.begin());
  }

  async begin(): Promise<void> {
    document.title = t("owner_title");
    if (!maySessionLive()) return this.signIn();
    try {
      this.enter(await this.api.get<OwnerSession>("/api/owner/me"));
      await this.go();
    } catch (error) {
      this.signIn(error instanceof Refused && error.code === "not_signed_in" ? "" : explain(error));
    }
  }

  private enter({ name, csrf }: OwnerSession): void {
    this.name = name;
    this.api.csrf = csrf;
    noteSession(true);
  }

  private signIn(problem = ""): void {
    this.stopTimers();
    this.name = "";
    noteSession(false);
    const status = h("p", { class: "problem", role: "alert" }, problem);
    const name = h("input", { name: "name", autocomplete: "username", required: true, maxlength: 128 });
    const password = h("input", {
      name: "password",
      type: "password",
      autocomplete: "current-password",
      required: true,
      maxlength: 256,
    });
    const button = h("button", { class: "button primary" }, t("owner_sign_in"));
    const form = h(
      "form",
      { class: "card sign-in" },
      h("h1", { tabindex: -1 }, t("owner_title")),
      h("label", {}, t("owner_name"), name),
      h("label", {}, t("owner_password"), password),
      status,
      button,
    );
    form.addEventListener("submit", (event) => {
      event.preventDefault();
      if (button.disabled) return;
      button.disabled = true;
      status.textContent = "";
      this.api.post<OwnerSession>("/api/owner/login", { name: name.value, password: password.value }).then(
        (session) => {
          this.enter(session);
          return this.go();
        },
        (error: unknown) => {
          status.textContent = explain(error);
          button.disabled = false;
          password.value = "";
          password.focus();
        },
      );
    });
    show(h("main", { class: "centre" }, form));
    name.focus();
  }

  private async signOut(): Promise<void> {
    await this.attempt(() => this.api.post<Done>("/api/owner/logout"));
    this.signIn();
  }

  private async go(): Promise<void> {
    this.stopTimers();
    const turn = ++this.turn;
    const [room = "", ...names] = location.hash.replace(/^#\/?/, "").split("/").map(decodeURIComponent);
    const views: Record<string, View> = { new: setupView, audit: auditView, study: studyView };
    try {
      const content = await (views[room] ?? listView)(this.desk(turn), ...names);
      if (turn === this.turn) show(this.header(room), content);
    } catch (error) {
      if (turn !== this.turn) return;
      if (isSessionGone(error)) this.signIn();
      else
        show(
          this.header(room),
          h("main", { class: "owner" }, h("p", { class: "problem", role: "alert" }, explain(error))),
        );
    }
  }

  private desk(turn: number): Desk {
    return {
      api: this.api,
      every: (seconds, work) => {
        const timer = setInterval(
          () =>
            void (
              turn === this.turn &&
              !document.hidden &&
              work().catch((error: unknown) => isSessionGone(error) && this.signIn())
            ),
          seconds * 1000,
        );
        this.timers.push(timer);
      },
      attempt: (work) => this.attempt(work),
    };
  }

  private async attempt(work: () => Promise<unknown>): Promise<boolean> {
    try {
      await work();
      return true;
    } catch (error) {
      if (isSessionGone(error)) this.signIn();
      else note(explain(error));
      return false;
    }
  }

  private header(room: string): HTMLElement {
    const link = (to: string, label: string, isHere: boolean) =>
      h("a", { href: `#/${to}`, "aria-current": isHere ? "page" : null }, label);
    return h(
      "header",
      { class: "top" },
      h("b", {}, t("owner_title")),
      h(
        "nav",
        { "aria-label": t("owner_title") },
        link("", t("owner_studies"), room !== "audit" && room !== "new"),
        link("new", t("owner_new"), room === "new"),
        link("audit", t("owner_audit"), room === "audit"),
      ),
      h("span", { class: "who" }, this.name),
      h(
        "button",
        { class: "button small sign-out", type: "button", onclick: () => void this.signOut() },
        t("owner_sign_out"),
      ),
    );
  }

  private stopTimers(): void {
    for (const timer of this.timers.splice(0)) clearInterval(timer);
  }
}

function isSessionGone(error: unknown): boolean {
  return error instanceof Refused && (error.code === "not_signed_in" || error.code === "bad_csrf");
}
