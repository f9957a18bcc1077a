/** The interface between the page of a task and its panel (pairwise or preference). */

import type { RaterTask, StudyFace } from "../api.generated.js";
import { h } from "../dom.js";
import { icon } from "../icons.js";
import type { ClipPlayer } from "../playback/player.js";
import { t } from "../strings.js";
import type { Draft } from "./draft.js";

export interface TaskContext {
  readonly task: RaterTask;
  readonly study: StudyFace;
  readonly draft: Draft;
  readonly player: ClipPlayer;
  /** Whether playback is looped; read when it starts. */
  readonly isLooped: () => boolean;
  /** Call after changing the draft: stores it and shows what is missing. */
  readonly changed: () => void;
}

export interface Panel {
  readonly title: string;
  readonly hint: string;
  /** Contains all views; the canvas covers it. */
  readonly host: HTMLElement;
  readonly views: readonly HTMLElement[];
  /** The questions below or beside the views; null if judging happens in the cells. */
  readonly judge: HTMLElement | null;
  /** Extra buttons for the row of controls. */
  readonly tools: readonly HTMLElement[];
  /** Label of the play button. */
  readonly play: string;
  /** Updates what is shown as playing, watched and chosen. */
  update(): void;
  toggle(): void;
  again(): void;
  /** Handles a key; returns whether it used it. */
  key(key: string): boolean;
  /** The choice as text; empty if the page shows it anyway. */
  summary(): string;
  ended(slots: readonly number[]): void;
  /** Called when the page closes; starts nothing afterwards. */
  close(): void;
}

/** A view with its name below. */
export function cell(
  slot: number,
  name: string,
  ...more: Node[]
): { element: HTMLElement; view: HTMLElement; status: HTMLElement } {
  const view = h("div", { class: "view", role: "img", "aria-label": t("clip_name", { name }) });
  const status = h("span", { class: "status" });
  const element = h(
    "div",
    { class: "cell", "data-slot": slot, role: "group", "aria-label": t("clip_name", { name }) },
    view,
    h("div", { class: "caption" }, h("b", { class: "name" }, name), status, ...more),
  );
  return { element, view, status };
}

/** Shows how often a clip was played, and whether to its end. */
export function showStatus(element: HTMLElement, context: TaskContext, slot: number): void {
  const { plays, watched } = context.draft;
  const isWatched = watched[slot]! >= Math.max(1, context.study.min_plays);
  const count = h("span", { class: "count", title: t("clip_begun", { count: plays[slot]! }) }, `× ${plays[slot]!}`);
  element.replaceChildren(
    ...(isWatched
      ? [
          h(
            "span",
            { class: "watched", title: t("clip_watched") },
            icon("tick"),
            h("span", { class: "unseen" }, t("clip_watched")),
          ),
        ]
      : []),
    ...(plays[slot] ? [count] : []),
  );
}
