/** What the two kinds of task have in common, as the page of a task sees it. */

import type { RaterTask, StudyFace } from "../api.generated.js";
import { h } from "../dom.js";
import { icon } from "../icons.js";
import type { Theatre } from "../playback/theatre.js";
import { t } from "../strings.js";
import type { Draft } from "./draft.js";

export interface Place {
  readonly task: RaterTask;
  readonly study: StudyFace;
  readonly draft: Draft;
  readonly theatre: Theatre;
  /** Whether playing goes round; asked when it begins. */
  readonly isLooped: () => boolean;
  /** The draft has changed: keep it, and show what is still missing. */
  readonly changed: () => void;
}

export interface Panel {
  readonly title: string;
  readonly hint: string;
  /** Holds all views; the canvas is laid upon it. */
  readonly host: HTMLElement;
  readonly views: readonly HTMLElement[];
  /** Below or beside the views; null where judging is done in the cells. */
  readonly judge: HTMLElement | null;
  /** For the row of controls. */
  readonly tools: readonly HTMLElement[];
  /** Name of the play button. */
  readonly play: string;
  /** Shows what is played, watched and chosen. */
  update(): void;
  toggle(): void;
  again(): void;
  /** Handles a key; whether it was one of its own. */
  key(key: string): boolean;
  /** What is chosen, in words; empty where the page shows it anyway. */
  summary(): string;
  ended(slots: readonly number[]): void;
  /** The page goes: nothing begins any more. */
  close(): void;
}

/** A view with its name below it. */
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

/** How often a clip was played, and whether to its end. */
export function showStatus(element: HTMLElement, place: Place, slot: number): void {
  const { plays, watched } = place.draft;
  const isWatched = watched[slot]! >= Math.max(1, place.study.min_plays);
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
