/** Sliders for how the speaker gestures, where the model follows them. */

import type { EchoSession } from "@echoavatar/client";
import { toggle } from "./panels.js";

const SENT_EVERY_MS = 200; // a dragged slider is no flood: the server takes 10 requests a second

export class MannerPanel {
  private readonly chosen: { liveliness?: number; handedness?: number } = {};
  private timer = 0;

  constructor(private readonly session: EchoSession, panel: HTMLElement, button: HTMLElement) {
    session.on("ready", ({ manner, resumed }) => {
      const labels = [...panel.querySelectorAll<HTMLElement>("[data-manner]")];
      for (const label of labels) label.hidden = !manner?.includes(label.dataset["manner"]!);
      button.hidden = labels.every((label) => label.hidden);
      if (button.hidden && !panel.hidden) toggle("manner", false);
      if (!button.hidden && !resumed) this.send(); // a new session would begin by its seed
    });
    panel.addEventListener("input", ({ target }) => this.choose(target as HTMLInputElement));
  }

  private choose(slider: HTMLInputElement): void {
    this.chosen[slider.name as "liveliness" | "handedness"] = Number(slider.value);
    this.timer ||= window.setTimeout(() => this.send(), SENT_EVERY_MS);
  }

  private send(): void {
    this.timer = 0;
    if (Object.keys(this.chosen).length) this.session.manner(this.chosen);
  }
}
