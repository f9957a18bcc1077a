/** Two motions, side by side in sync or one after the other, with questions on a five-point scale. */

import { h } from "../dom.js";
import { type Key, t, word } from "../strings.js";
import { type Panel, type TaskContext, cell, showStatus } from "./panel.js";

const NAMES = ["A", "B"] as const;
const BETWEEN_MS = 800; // pause between the first and the second clip
const RATINGS: readonly [number, Key][] = [
  [-2, "rating_m2"],
  [-1, "rating_m1"],
  [0, "rating_0"],
  [1, "rating_1"],
  [2, "rating_2"],
];

export class PairwisePanel implements Panel {
  readonly title = t("task_title_pairwise");
  readonly tools: readonly HTMLElement[] = [];
  readonly host: HTMLElement;
  readonly views: readonly HTMLElement[];
  readonly judge: HTMLElement;
  private readonly cells: readonly ReturnType<typeof cell>[];
  private readonly order: readonly number[];
  private readonly isSequential: boolean;
  private waiting: ReturnType<typeof setTimeout> | undefined;

  constructor(private readonly context: TaskContext) {
    this.isSequential = context.study.presentation === "sequential";
    this.order = context.task.first === 1 ? [1, 0] : [0, 1];
    this.cells = NAMES.map((name, slot) => {
      const play = h(
        "button",
        { class: "button small", type: "button", onclick: () => this.start([slot]) },
        t("play_clip", { name }),
      );
      return cell(slot, name, ...(this.isSequential ? [play] : []));
    });
    this.cells.forEach(({ view }) => view.append(h("p", { class: "curtain" })));
    this.views = this.cells.map(({ view }) => view);
    this.host = h("div", { class: "host pair" }, ...this.cells.map(({ element }) => element));
    this.judge = h(
      "form",
      { class: "judge", onsubmit: (event) => event.preventDefault() },
      ...context.study.questions.map((question) => this.question(question)),
    );
  }

  get hint(): string {
    return t(this.isSequential ? "task_hint_sequential" : "task_hint_side");
  }

  get play(): string {
    if (!this.isSequential) return t("play_both");
    return t("play_clip", { name: NAMES[this.next] ?? "" });
  }

  update(): void {
    const { player, draft } = this.context;
    this.cells.forEach(({ element, status }, slot) => {
      showStatus(status, this.context, slot);
      element.classList.toggle("on", player.slots?.includes(slot) ?? false);
    });
    for (const input of this.judge.querySelectorAll("input"))
      input.checked = draft.ratings[input.name] === Number(input.value);
    if (this.isSequential) this.draw();
  }

  toggle(): void {
    const { player } = this.context;
    if (player.isPlaying) player.pause();
    else if (player.slots) void player.resume();
    else this.start(this.isSequential ? [this.next] : [0, 1]);
  }

  again(): void {
    this.start(this.isSequential ? (this.context.player.slots ?? [this.next]) : [0, 1]);
  }

  key(key: string): boolean {
    if (key !== "1" && key !== "2") return false;
    this.start(this.isSequential ? [Number(key) - 1] : [0, 1]);
    return true;
  }

  summary(): string {
    return "";
  }

  /** Plays the second clip once automatically after the first. */
  ended(slots: readonly number[]): void {
    const other = this.order.find((slot) => !slots.includes(slot) && !this.context.draft.watched[slot]);
    if (!this.isSequential || other === undefined) return;
    this.waiting = setTimeout(() => this.start([other]), BETWEEN_MS);
  }

  close(): void {
    clearTimeout(this.waiting);
  }

  /** The clip to play next: the first unwatched one in the study's order. */
  private get next(): number {
    return this.order.find((slot) => !this.context.draft.watched[slot]) ?? this.order[0]!;
  }

  private start(slots: readonly number[]): void {
    clearTimeout(this.waiting);
    const hasSeenAll = this.context.draft.watched.every(Boolean);
    void this.context.player.play(slots, this.context.isLooped() && (!this.isSequential || hasSeenAll));
  }

  /** In sequential studies, hides the clip that is not playing. */
  private draw(): void {
    const { player } = this.context;
    const shown = player.slots ?? [];
    const hidden = [0, 1].filter((slot) => !shown.includes(slot));
    player.cover(hidden);
    this.cells.forEach(({ view }, slot) => {
      const curtain = view.querySelector(".curtain")!;
      curtain.textContent = hidden.includes(slot)
        ? slot === this.next && !shown.length
          ? t("clip_next", { name: NAMES[slot]! })
          : NAMES[slot]!
        : "";
    });
  }

  private question(question: string): HTMLElement {
    const [a, b] = NAMES;
    const choices = RATINGS.map(([rating, key]) =>
      h(
        "label",
        { class: "choice" },
        h("input", { type: "radio", name: question, value: rating, onchange: () => this.rate(question, rating) }),
        h("span", {}, t(key, { a, b })),
      ),
    );
    return h(
      "fieldset",
      { class: "question", "data-question": question },
      h("legend", {}, word("question", question)),
      h("div", { class: "scale" }, ...choices),
    );
  }

  private rate(question: string, rating: number): void {
    this.context.draft.ratings[question] = rating;
    this.context.changed();
  }
}
