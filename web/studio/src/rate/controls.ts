/** The row below the views: play, restart, progress, loop, sound and camera. */

import { h } from "../dom.js";
import { type Icon, icon } from "../icons.js";
import type { ClipPlayer } from "../playback/player.js";
import type { SharedCamera } from "../playback/camera.js";
import { t } from "../strings.js";

export interface Playing {
  readonly label: string;
  /** Plays, pauses or resumes. */
  toggle(): void;
  /** Restarts. */
  again(): void;
}

export class Controls {
  readonly element: HTMLElement;
  isLooped = !matchMedia("(prefers-reduced-motion: reduce)").matches;
  private readonly play: HTMLButtonElement;
  private readonly loop: HTMLButtonElement;
  private readonly sound: HTMLButtonElement;
  private readonly bar = h("div", { class: "time" }, h("i"));

  constructor(
    private readonly player: ClipPlayer,
    camera: SharedCamera,
    private readonly playing: Playing,
    ...more: HTMLElement[]
  ) {
    this.play = h("button", { class: "button primary play", type: "button", onclick: () => playing.toggle() });
    this.loop = tool("loop", t("loop"), () => this.toggleLoop());
    this.sound = tool("sound", t("sound"), () => this.toggleSound());
    const view = [
      tool("left", t("view_left"), () => camera.step(-1, 0)),
      tool("right", t("view_right"), () => camera.step(1, 0)),
      tool("closer", t("view_closer"), () => camera.step(0, 1)),
      tool("farther", t("view_farther"), () => camera.step(0, -1)),
      tool("reset", t("view_reset"), () => camera.reset()),
    ];
    this.element = h(
      "div",
      { class: "controls" },
      this.play,
      tool("again", t("again"), () => playing.again()),
      this.bar,
      this.loop,
      this.sound,
      h("div", { class: "camera", role: "group", "aria-label": t("view") }, ...view),
      ...more,
    );
    player.onTime = (share) => this.bar.style.setProperty("--at", String(share));
    this.update();
  }

  update(): void {
    const { isPlaying, sound } = this.player;
    this.play.replaceChildren(
      icon(isPlaying ? "pause" : "play"),
      h("span", {}, isPlaying ? t("pause") : this.playing.label),
    );
    this.loop.setAttribute("aria-pressed", String(this.isLooped));
    this.sound.setAttribute("aria-pressed", String(!sound.muted));
    this.sound.replaceChildren(icon(sound.muted ? "muted" : "sound"));
  }

  toggleLoop(): void {
    this.isLooped = !this.isLooped;
    this.update();
  }

  toggleSound(): void {
    this.player.sound.muted = !this.player.sound.muted;
    this.update();
  }
}

export function tool(name: Icon, label: string, run: () => void): HTMLButtonElement {
  return h("button", { class: "tool", type: "button", "aria-label": label, title: label, onclick: run }, icon(name));
}
