/** The page of one task: shows it, keeps the draft and sends the answer. */

import type { Answer, NextTask, RaterTask, Saved, StudyFace } from "../api.generated.js";
import { ask, h, note, show } from "../dom.js";
import { explain } from "../explain.js";
import type { Media } from "../playback/media.js";
import type { ClipPlayer } from "../playback/player.js";
import type { Views } from "../playback/views.js";
import { t } from "../strings.js";
import { answerOf, isChosen, isReady, skipOf, unwatched } from "./answer.js";
import { Controls } from "./controls.js";
import { type Draft, keepDraft, openDraft } from "./draft.js";
import { onKeys } from "./keys.js";
import { PairwisePanel } from "./pairwise.js";
import type { Panel } from "./panel.js";
import { PreferencePanel } from "./preference.js";
import type { Outcome } from "./sending.js";

export interface TaskSetting {
  readonly study: StudyFace;
  readonly next: NextTask & { task: RaterTask };
  readonly player: ClipPlayer;
  readonly views: Views;
  readonly media: Media;
  readonly menu: HTMLElement;
  /** Sends a draft's answer; `onWait` is called before each retry. */
  readonly send: (draft: Draft, onWait: (seconds: number) => void) => Promise<Outcome>;
  readonly hurry: () => void;
  readonly done: (outcome: Outcome) => void;
}

export class TaskPage {
  readonly draft: Draft;
  private readonly panel: Panel;
  private readonly controls: Controls;
  private readonly status = h("p", { class: "missing", role: "status" });
  private readonly submit: HTMLButtonElement;
  private readonly skip: HTMLButtonElement;
  private readonly broken: HTMLButtonElement;
  private readonly main: HTMLElement;
  private began = performance.now();
  private isSending = false;
  private isClosed = false;
  private readonly leave: () => void;

  constructor(private readonly setting: TaskSetting) {
    const { study, player, views, media, next } = setting;
    const task = next.task;
    this.draft = openDraft(task);
    const context = {
      task,
      study,
      draft: this.draft,
      player,
      isLooped: () => this.controls.isLooped,
      changed: () => this.changed(),
    };
    this.panel = study.kind === "pairwise" ? new PairwisePanel(context) : new PreferencePanel(context);
    const { panel } = this;
    const playing = {
      get label() {
        return panel.play;
      },
      toggle: () => panel.toggle(),
      again: () => panel.again(),
    };
    this.controls = new Controls(player, views.camera, playing, ...panel.tools);
    const label = task.stage === "training" ? "submit_training" : "submit";
    this.submit = h(
      "button",
      { class: "button primary submit", type: "button", onclick: () => this.answer() },
      t(label),
    );
    this.skip = h(
      "button",
      { class: "button skip", type: "button", hidden: study.kind === "pairwise", onclick: () => this.skipTask() },
      t("skip"),
    );
    this.broken = h(
      "button",
      { class: "button quiet broken", type: "button", onclick: () => void this.tellBroken() },
      t("broken"),
    );
    this.main = this.build();
    show(taskHeader(setting), this.main);
    Object.assign(player, {
      onChange: () => this.changed(),
      onEnd: (slots: number[]) => this.panel.ended(slots),
      onStuck: () => note(t("stuck")),
    });
    player.set(this.panel.host, this.panel.views, media, task.seconds, this.draft);
    this.leave = onKeys((key) => this.key(key));
    addEventListener("pagehide", this.keep);
    this.changed();
    if (this.draft.sent) void this.send(); // it was sent before a reload; send again with the same key
  }

  /** Closes the page. */
  close(): void {
    this.isClosed = true;
    this.panel.close();
    this.leave();
    removeEventListener("pagehide", this.keep);
    this.setting.player.stop();
  }

  get busy(): boolean {
    return this.isSending;
  }

  private build(): HTMLElement {
    const { panel } = this;
    const isTraining = this.setting.next.task.stage === "training";
    return h(
      "main",
      { class: `task ${this.setting.study.kind}${isTraining ? " practice" : ""}` },
      h(
        "div",
        { class: "ask-line" },
        h("h1", { tabindex: -1 }, panel.title),
        h("p", { class: "hint" }, panel.hint),
        isTraining && h("p", { class: "training" }, t("task_training")),
      ),
      h("section", { class: "stage" }, panel.host, this.controls.element),
      panel.judge,
      h("footer", { class: "foot" }, this.status, this.broken, this.skip, this.submit),
    );
  }

  /** Seconds since the first display frame, across reloads. */
  private get seconds(): number {
    return this.draft.spent + (performance.now() - this.began) / 1000;
  }

  private readonly keep = () => {
    if (this.isClosed) return;
    this.draft.spent = this.seconds;
    this.began = performance.now();
    keepDraft(this.draft);
  };

  private changed(): void {
    this.keep();
    this.panel.update();
    this.controls.update();
    if (!this.isSending) this.showMissing();
  }

  private showMissing(): void {
    const { draft, panel } = this;
    const { study } = this.setting;
    const names = unwatched(draft, study).map((slot) => (study.kind === "pairwise" ? "AB"[slot] : slot + 1));
    const open = study.questions.filter((question) => draft.ratings[question] === undefined).length;
    const parts = [panel.summary()];
    if (names.length) parts.push(t("still_to_watch", { names: names.join(", ") }));
    else if (!isChosen(draft, study))
      parts.push(study.kind === "pairwise" ? t("still_to_answer", { count: open }) : t("still_to_mark"));
    this.setStatus(parts.filter(Boolean).join(" "));
    this.submit.disabled = !isReady(draft, study);
    this.skip.disabled = names.length > 0;
    this.broken.disabled = false;
  }

  private setStatus(text: string, ...more: Node[]): void {
    if (this.status.firstChild?.textContent !== text || more.length)
      this.status.replaceChildren(h("span", {}, text), ...more);
  }

  private answer(): void {
    if (this.isSending || !isReady(this.draft, this.setting.study)) return;
    this.begin(answerOf(this.draft, this.setting.study, this.seconds));
  }

  private skipTask(): void {
    if (!this.isSending && !unwatched(this.draft, this.setting.study).length)
      this.begin(skipOf(this.draft, "no_difference", this.seconds));
  }

  private async tellBroken(): Promise<void> {
    if (this.isSending || !(await ask(t("broken_ask"), t("broken_yes"), t("cancel"))) || this.isSending) return;
    this.begin(skipOf(this.draft, "cannot_play", this.seconds));
  }

  private begin(answer: Answer): void {
    this.draft.sent = answer;
    keepDraft(this.draft);
    void this.send();
  }

  /** Sends the answer; a second click while sending does nothing. */
  private async send(): Promise<void> {
    if (this.isSending) return;
    this.isSending = true;
    this.setting.player.pause();
    this.lock(true);
    this.setStatus(t("saving"));
    try {
      const outcome = await this.setting.send(this.draft, (seconds) => this.tellWait(seconds));
      if (outcome.kind !== "refused") return this.setting.done(outcome);
      note(explain(outcome.refused));
      if (outcome.refused.code === "study_closed") return this.setting.done(outcome);
    } catch (error) {
      note(explain(error));
    }
    this.draft.sent = null;
    this.isSending = false;
    this.lock(false);
    this.changed();
  }

  private tellWait(seconds: number): void {
    if (!seconds) return this.setStatus(t("saving"));
    const again = h(
      "button",
      { class: "button small", type: "button", onclick: () => this.setting.hurry() },
      t("retry_now"),
    );
    this.setStatus(t("not_saved", { seconds: Math.ceil(seconds) }), again);
  }

  private lock(isLocked: boolean): void {
    this.main.classList.toggle("sending", isLocked);
    this.main.setAttribute("aria-busy", String(isLocked));
    this.panel.judge?.toggleAttribute("inert", isLocked);
    this.panel.host.toggleAttribute("inert", isLocked);
    for (const button of [this.submit, this.skip, this.broken]) button.disabled = isLocked;
  }

  private key(key: string): boolean {
    if (this.isSending) return false;
    const { camera } = this.setting.views;
    if (key === " ") this.panel.toggle();
    else if (key === "r") this.panel.again();
    else if (key === ",") camera.step(-1, 0);
    else if (key === ".") camera.step(1, 0);
    else if (key === "+" || key === "-") camera.step(0, key === "+" ? 1 : -1);
    else if (key === "v") camera.reset();
    else if (key === "m") this.controls.toggleSound();
    else if (key === "l") this.controls.toggleLoop();
    else if (key === "Enter") this.answer();
    else return this.panel.key(key);
    return true;
  }
}

/** The top bar: study title, progress and menu. */
export function taskHeader({ study, next, menu }: Pick<TaskSetting, "study" | "next" | "menu">): HTMLElement {
  const { done, of }: Saved["progress"] = next.progress;
  const label = t("task_progress_label", { done, of });
  return h(
    "header",
    { class: "bar" },
    h("span", { class: "study" }, study.title),
    h(
      "div",
      {
        class: "progress",
        role: "progressbar",
        "aria-valuemin": 0,
        "aria-valuemax": of,
        "aria-valuenow": done,
        "aria-label": label,
        "aria-valuetext": label,
      },
      h("i", { style: `--share: ${of ? done / of : 1}` }),
    ),
    h("span", { class: "number" }, t("task_progress", { number: next.task?.number ?? of, of })),
    menu,
  );
}
