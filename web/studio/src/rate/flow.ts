/** A rater's path: link, consent, tasks, thanks. The studio decides each step, so none can be skipped or repeated. */

import { Api, Refused } from "../api.js";
import type { Done, Joined, NextTask, RaterTask, Scene } from "../api.generated.js";
import { h, note, show } from "../dom.js";
import { explain } from "../explain.js";
import { Pause, retry } from "../retry.js";
import { Library, type Media } from "../playback/media.js";
import { ClipPlayer } from "../playback/player.js";
import { Views } from "../playback/views.js";
import { type Words, speak, t } from "../strings.js";
import { type Draft, dropDraft, openDraft, unsaved } from "./draft.js";
import { menu } from "./menu.js";
import { type Outcome, send } from "./sending.js";
import { TaskPage, taskHeader } from "./task.js";
import { showConsent, showWords } from "./words.js";

const RESUME = "resume link";

interface Show {
  readonly views: Views;
  readonly player: ClipPlayer;
  readonly library: Library;
}

export class Flow {
  readonly api = new Api();
  private readonly pause = new Pause();
  private readonly channel = new BroadcastChannel("echoavatar-studio");
  private joined: Joined | null = null;
  private shown: Promise<Show> | null = null;
  private page: TaskPage | null = null;
  /** For tests. */
  player: ClipPlayer | null = null;

  constructor() {
    this.channel.onmessage = ({ data }: MessageEvent<{ saved?: string }>) => this.hear(data.saved);
    addEventListener("pageshow", (event) => event.persisted && !this.page?.busy && void this.begin());
    addEventListener("hashchange", () => location.hash.length > 1 && void this.begin());
  }

  /** Starts from the link, or from this browser's session. */
  async begin(): Promise<void> {
    this.closePage();
    showWords(t("loading"), []);
    try {
      const token = location.hash.slice(1);
      await this.enter(token ? await this.join(token) : await this.again(() => this.api.get<Joined>("/api/rater/me")));
      for (const draft of unsaved()) await this.sendOld(draft);
      if (!this.joined!.has_consented) this.consent();
      else await this.next();
    } catch (error) {
      this.stopped(error);
    }
  }

  private async join(token: string): Promise<Joined> {
    const joined = await this.again(() => this.api.post<Joined>("/api/rater/join", { token }));
    history.replaceState(null, "", location.pathname + location.search); // removes the key from the address bar
    return joined;
  }

  private async enter(joined: Joined): Promise<void> {
    this.joined = joined;
    this.api.csrf = joined.csrf;
    document.title = joined.study.title;
    if (joined.resume) sessionStorage.setItem(RESUME, joined.resume);
    this.shown ??= this.open(); // loads while the rater reads
    this.shown.catch(() => undefined);
    await speak(joined.study.language, (code) => this.words(code));
  }

  private async words(language: string): Promise<Words | null> {
    try {
      return await this.again(() => this.api.get<Words>(`/words/${language}.json`));
    } catch (error) {
      if (error instanceof Refused && error.code === "not_found") return null;
      throw error;
    }
  }

  private consent(): void {
    showConsent(this.joined!, sessionStorage.getItem(RESUME) ?? "", async (agreed) => {
      try {
        await this.enter(await this.again(() => this.api.post<Joined>("/api/rater/consent", { agreed })));
        await this.next();
      } catch (error) {
        if (!agreed && error instanceof Refused && error.code === "not_signed_in") this.gone("rate_kept_nothing");
        else this.stopped(error);
      }
    });
  }

  /** Shows the current task, or the end page. */
  private async next(): Promise<void> {
    this.closePage();
    const next = await this.again(() => this.api.get<NextTask>("/api/rater/task"));
    const task = next.task;
    if (!task) return this.finished(next.progress.of);
    const setting = { study: this.joined!.study, next: { ...next, task }, menu: this.menu() };
    const bar = h("p", { class: "preparing", role: "status" });
    const percent = (share: number) => (bar.textContent = t("task_preparing", { percent: Math.round(share * 100) }));
    percent(0);
    show(taskHeader(setting), h("main", { class: "words" }, bar));
    let shown: Show;
    let media: Media;
    try {
      shown = await this.again(() => this.shown!, bar);
      media = await shown.library.load(task, percent, {
        pause: this.pause,
        onWait: (seconds) => this.tellWait(bar, seconds),
      });
    } catch (error) {
      if (error instanceof Refused) throw error;
      return this.cannotPlay(task, error);
    }
    shown.library.ahead(task, next.ahead);
    this.page = new TaskPage({
      ...setting,
      views: shown.views,
      player: shown.player,
      media,
      send: (draft, onWait) => this.send(draft, onWait),
      hurry: () => this.pause.hurry(),
      done: (outcome) => void this.done(outcome),
    });
  }

  /** Sends an answer. If the session has changed meanwhile, renews it and sends once more. */
  private async send(draft: Draft, onWait: (seconds: number) => void): Promise<Outcome> {
    const insisting = { pause: this.pause, onWait };
    const outcome = await send(this.api, draft, insisting);
    if (outcome.kind !== "session") return outcome;
    try {
      await this.enter(await this.again(() => this.api.get<Joined>("/api/rater/me")));
    } catch (error) {
      if (error instanceof Refused) return outcome; // the rater must open the link again; the draft stays in this tab
      throw error;
    }
    return send(this.api, draft, insisting);
  }

  private async sendOld(draft: Draft): Promise<void> {
    showWords(t("saving"), []);
    const outcome = await this.send(draft, (seconds) =>
      showWords(t("saving"), seconds ? [t("not_saved", { seconds: Math.ceil(seconds) })] : []),
    );
    if (outcome.kind === "saved") this.tellSaved(draft.task);
    else dropDraft(draft.task);
  }

  private async done(outcome: Outcome): Promise<void> {
    const task = this.page?.draft.task ?? "";
    if (outcome.kind === "saved") this.tellSaved(task);
    else if (outcome.kind === "elsewhere") note(t("saved_elsewhere"));
    try {
      if (outcome.kind === "refused") throw outcome.refused;
      if (outcome.kind === "session") return await this.begin();
      await this.next();
    } catch (error) {
      this.stopped(error);
    }
  }

  private tellSaved(task: string): void {
    note(t("saved"));
    this.channel.postMessage({ saved: task });
  }

  /** Moves on when another tab has saved the task that is shown here. */
  private hear(task: string | undefined): void {
    if (!task || this.page?.draft.task !== task || this.page.busy) return;
    dropDraft(task);
    note(t("saved_elsewhere"));
    void this.next().catch((error: unknown) => this.stopped(error));
  }

  /** Loads the character and the renderer, once for all tasks. */
  private async open(): Promise<Show> {
    const scene = await retry(() => this.api.get<Scene>("/api/scene"), { pause: this.pause });
    const character = await retry(() => this.api.bytes(scene.avatar), { pause: this.pause });
    const quality = new URLSearchParams(location.search).get("quality");
    const views = await Views.open(scene, character, quality);
    this.player = new ClipPlayer(views);
    return { views, player: this.player, library: new Library(this.api, scene) };
  }

  private cannotPlay(task: RaterTask, error: unknown): void {
    const skip = h(
      "button",
      {
        class: "button",
        type: "button",
        onclick: async () => {
          const draft = openDraft(task);
          draft.sent ??= { type: "skip", reason: "cannot_play", seconds: 0, plays: draft.plays };
          skip.disabled = true;
          await this.send(draft, () => undefined).then(
            (outcome) => this.done(outcome),
            (reason: unknown) => this.stopped(reason),
          );
        },
      },
      t("broken_yes"),
    );
    const retry = h(
      "button",
      {
        class: "button primary",
        type: "button",
        onclick: () => {
          this.shown = this.open();
          void this.begin();
        },
      },
      t("retry_now"),
    );
    showWords(t("rate_refused_title"), [t("task_broken", { message: explain(error) })], retry, skip);
  }

  private menu(): HTMLElement {
    const act = (path: string, body: object | null, key: "rate_left" | "rate_withdrawn") => async () => {
      try {
        await this.again(() => this.api.post<Done>(path, body));
        this.gone(key);
      } catch (error) {
        note(explain(error));
      }
    };
    const leaving = {
      leave: act("/api/rater/leave", null, "rate_left"),
      withdraw: act("/api/rater/withdraw", { sure: true }, "rate_withdrawn"),
    };
    return menu(this.joined!.study.kind, sessionStorage.getItem(RESUME) ?? "", leaving);
  }

  private finished(of: number): void {
    showWords(t("rate_finished_title"), [t("rate_finished", { of })], this.menu());
  }

  private gone(what: "rate_left" | "rate_withdrawn" | "rate_kept_nothing"): void {
    this.closePage();
    sessionStorage.clear();
    showWords(t(`${what}_title`), [t(what)]);
  }

  private stopped(error: unknown): void {
    this.closePage();
    if (error instanceof Refused && error.code === "not_signed_in")
      return showWords(t("rate_no_link_title"), [t("rate_no_link")]);
    showWords(t("rate_refused_title"), [explain(error)]);
  }

  private closePage(): void {
    this.page?.close();
    this.page = null;
  }

  /** Retries until the studio answers; meanwhile `where` shows that it does not. */
  private again<Answer>(work: () => Promise<Answer>, where?: HTMLElement): Promise<Answer> {
    return retry(work, { pause: this.pause, onWait: (seconds) => this.tellWait(where, seconds) });
  }

  private tellWait(where: HTMLElement | undefined, seconds: number): void {
    const text = seconds ? t("retrying", { seconds: Math.ceil(seconds) }) : "";
    if (where) where.textContent = text;
    else if (text) note(text);
  }
}
