/** Several candidates for one sound; the rater picks the best and the worst. A grid, or one at a time. */

import { h } from "../dom.js";
import { icon } from "../icons.js";
import { t } from "../strings.js";
import { mark } from "./answer.js";
import { type Panel, type TaskContext, cell, showStatus } from "./panel.js";

const NARROW = "(max-width: 719px)";

export class PreferencePanel implements Panel {
  readonly title = t("task_title_preference");
  readonly hint = t("task_hint_preference");
  readonly judge = null;
  readonly host: HTMLElement;
  readonly views: readonly HTMLElement[];
  readonly tools: readonly HTMLElement[];
  private readonly cells: readonly ReturnType<typeof cell>[];
  private readonly marks: readonly Record<"best" | "worst", HTMLButtonElement>[];
  private readonly strip: HTMLElement;
  private readonly layout: HTMLButtonElement;
  private current = 0;
  private isGrid = !matchMedia(NARROW).matches;

  constructor(private readonly context: TaskContext) {
    const slots = context.task.clips.map((_, slot) => slot);
    this.marks = slots.map((slot) => ({ best: this.markButton("best", slot), worst: this.markButton("worst", slot) }));
    this.cells = slots.map((slot) => this.cell(slot));
    this.views = this.cells.map(({ view }) => view);
    this.strip = h(
      "div",
      { class: "strip", role: "group" },
      ...slots.map((slot) =>
        h(
          "button",
          {
            type: "button",
            class: "chip",
            "aria-label": t("clip_name", { name: slot + 1 }),
            onclick: () => this.go(slot),
          },
          slot + 1,
        ),
      ),
    );
    this.host = h(
      "div",
      { class: "host grid", style: `--columns: ${columns(slots.length)}` },
      ...this.cells.map(({ element }) => element),
    );
    this.layout = h("button", { class: "button small", type: "button", onclick: () => this.setGrid(!this.isGrid) });
    const all = h(
      "button",
      { class: "button small all", type: "button", onclick: () => this.playAll() },
      t("play_all"),
    );
    this.tools = [all, this.layout, this.strip];
    this.setGrid(this.isGrid);
  }

  get play(): string {
    return t("play_clip", { name: this.current + 1 });
  }

  update(): void {
    const { player, draft } = this.context;
    this.cells.forEach(({ element, status }, slot) => {
      showStatus(status, this.context, slot);
      element.classList.toggle("on", player.slots?.includes(slot) ?? false);
      element.classList.toggle("current", slot === this.current);
      for (const which of ["best", "worst"] as const) {
        this.marks[slot]![which].setAttribute("aria-pressed", String(draft[which] === slot));
        element.classList.toggle(which, draft[which] === slot);
      }
      const chip = this.strip.children[slot]!;
      chip.className = `chip ${draft.best === slot ? "best" : draft.worst === slot ? "worst" : draft.watched[slot] ? "seen" : ""}`;
      chip.setAttribute("aria-current", String(slot === this.current));
    });
  }

  toggle(): void {
    const { player } = this.context;
    if (player.isPlaying) player.pause();
    else if (player.slots?.includes(this.current)) void player.resume();
    else this.start(this.current);
  }

  again(): void {
    const { player } = this.context;
    if ((player.slots?.length ?? 0) > 1) this.playAll();
    else this.start(this.current);
  }

  key(key: string): boolean {
    const many = this.cells.length;
    if (/^[1-9]$/.test(key) && Number(key) <= many) this.start(Number(key) - 1);
    else if (key === "ArrowLeft" || key === "ArrowRight")
      this.go((this.current + (key === "ArrowRight" ? 1 : many - 1)) % many);
    else if (key === "b" || key === "w") this.mark(key === "b" ? "best" : "worst", this.current);
    else if (key === "a") this.playAll();
    else return false;
    return true;
  }

  summary(): string {
    const { best, worst } = this.context.draft;
    const name = (slot: number | null) => (slot === null ? t("none") : slot + 1);
    return best === null && worst === null ? "" : t("chosen", { best: name(best), worst: name(worst) });
  }

  ended(): void {}

  close(): void {}

  /** Selects a candidate; if something plays, playback moves to it from the start. */
  private go(slot: number): void {
    const { player } = this.context;
    const wasPlaying = player.isPlaying;
    this.current = slot;
    if (!this.isGrid) this.setGrid(false);
    if (wasPlaying) this.start(slot);
    else player.stop();
    this.context.changed();
    if (this.isGrid) this.cells[slot]!.element.scrollIntoView({ block: "nearest" });
  }

  private start(slot: number): void {
    this.current = slot;
    if (!this.isGrid) this.setGrid(false);
    void this.context.player.play([slot], this.context.isLooped());
  }

  private playAll(): void {
    if (!this.isGrid) this.setGrid(true);
    void this.context.player.play(
      this.cells.map((_, slot) => slot),
      this.context.isLooped(),
    );
  }

  private mark(which: "best" | "worst", slot: number): void {
    this.current = slot;
    mark(this.context.draft, which, slot);
    this.context.changed();
  }

  private setGrid(isGrid: boolean): void {
    this.isGrid = isGrid;
    this.host.classList.toggle("one", !isGrid);
    this.cells.forEach(({ element }, slot) => (element.hidden = !isGrid && slot !== this.current));
    this.layout.textContent = t(isGrid ? "one" : "grid");
    this.strip.hidden = isGrid;
    this.context.player.fit();
  }

  private cell(slot: number): ReturnType<typeof cell> {
    const { best, worst } = this.marks[slot]!;
    const play = h(
      "button",
      {
        class: "tool",
        type: "button",
        "aria-label": t("play_clip", { name: slot + 1 }),
        title: t("play_clip", { name: slot + 1 }),
        onclick: () => this.start(slot),
      },
      icon("play"),
    );
    return cell(slot, String(slot + 1), play, h("span", { class: "marks" }, best, worst));
  }

  private markButton(which: "best" | "worst", slot: number): HTMLButtonElement {
    const label = t(which === "best" ? "mark_best" : "mark_worst", { name: slot + 1 });
    return h(
      "button",
      {
        class: `mark ${which}`,
        type: "button",
        "aria-label": label,
        "aria-pressed": "false",
        onclick: () => this.mark(which, slot),
      },
      icon(which),
      h("span", {}, t(which)),
    );
  }
}

/** Number of columns for the cells on a wide screen: two rows, up to sixteen cells. */
function columns(cells: number): number {
  return cells <= 3 ? cells : Math.ceil(cells / 2);
}
