/** Two motions, side by side in sync or one after the other, and questions on a five-point scale. */

import { h } from "../dom.js";
import { type Key, t, word } from "../strings.js";
import { type Panel, type Place, cell, showStatus } from "./panel.js";

const NAMES = ["A", "B"] as const;
const BETWEEN_MS = 800; // from the end of the first to the beginning of the second
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

  constructor(private readonly place: Place) {
    this.isSequential = place.study.presentation === "sequential";
    this.order = place.task.first === 1 ? [1, 0] : [0, 1];
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
      ...place.study.questions.map((question) => this.question(question)),
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
    const { theatre, draft } = this.place;
    this.cells.forEach(({ element, status }, slot) => {
      showStatus(status, this.place, slot);
      element.classList.toggle("on", theatre.slots?.includes(slot) ?? false);
    });
    for (const input of this.judge.querySelectorAll("input"))
      input.checked = draft.ratings[input.name] === Number(input.value);
    if (this.isSequential) this.draw();
  }

  toggle(): void {
    const { theatre } = this.place;
    if (theatre.isPlaying) theatre.pause();
    else if (theatre.slots) void theatre.resume();
    else this.start(this.isSequential ? [this.next] : [0, 1]);
  }

  again(): void {
    this.start(this.isSequential ? (this.place.theatre.slots ?? [this.next]) : [0, 1]);
  }

  key(key: string): boolean {
    if (key !== "1" && key !== "2") return false;
    this.start(this.isSequential ? [Number(key) - 1] : [0, 1]);
    return true;
  }

  summary(): string {
    return "";
  }

  /** After the first comes the second, by itself, once. */
  ended(slots: readonly number[]): void {
    const other = this.order.find((slot) => !slots.includes(slot) && !this.place.draft.watched[slot]);
    if (!this.isSequential || other === undefined) return;
    this.waiting = setTimeout(() => this.start([other]), BETWEEN_MS);
  }

  close(): void {
    clearTimeout(this.waiting);
  }

  /** The clip that is to be played now: the first that was not watched, in the study's order. */
  private get next(): number {
    return this.order.find((slot) => !this.place.draft.watched[slot]) ?? this.order[0]!;
  }

  private start(slots: readonly number[]): void {
    clearTimeout(this.waiting);
    const hasSeenAll = this.place.draft.watched.every(Boolean);
    void this.place.theatre.play(slots, this.place.isLooped() && (!this.isSequential || hasSeenAll));
  }

  /** One after the other: what is not played now is behind a curtain. */
  private draw(): void {
    const { theatre } = this.place;
    const shown = theatre.slots ?? [];
    const hidden = [0, 1].filter((slot) => !shown.includes(slot));
    theatre.cover(hidden);
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
    this.place.draft.ratings[question] = rating;
    this.place.changed();
  }
}
