/** The round buttons at the top and their keyboard shortcuts. */

import type { EchoSession } from "@echoavatar/client";
import { STAGES } from "@echoavatar/client/three";
import type { AvatarSlot } from "./avatars.js";
import { setIcon } from "./icons.js";
import { openMenu, toast } from "./notices.js";
import type { Output } from "./output.js";
import { type MotionKind, MotionRecorder, VideoRecorder, download } from "./recorder.js";
import type { Viewport } from "./viewport.js";

const element = <Kind extends HTMLElement>(id: string) => document.getElementById(id) as Kind;
type Kind = MotionKind | "webm";
const KINDS: readonly { id: Kind; label: string; hint: string }[] = [
  { id: "webm", label: "Video with sound", hint: "WebM, 1920 × 1080" },
  { id: "glb", label: "The moving character", hint: "GLB, for Blender, Unity, Unreal, Godot" },
  { id: "vrma", label: "Motion for VRM avatars", hint: "VRMA, body and face" },
  { id: "bvh", label: "Motion capture file", hint: "BVH, body" },
];
const KEYS: Record<string, string> = { c: "look", m: "sound", t: "theme", l: "meters", r: "record", "?": "help", Escape: "stop" };

export class Tools {
  private recording: { stop(): Promise<File> } | null = null;

  constructor(
    private readonly viewport: Viewport,
    private readonly session: EchoSession,
    private readonly avatar: AvatarSlot,
    private readonly output: () => Output | null,
  ) {
    element("look").onclick = () => viewport.nextView();
    element("theme").onclick = () => this.setTheme(document.documentElement.dataset["theme"] !== "dark");
    element("sound").onclick = () => this.toggleSound();
    element("meters").onclick = () => this.toggleMeters();
    element("record").onclick = () => void this.record();
    element("help").onclick = () => element<HTMLDialogElement>("about").showModal();
    window.addEventListener("keydown", (event) => this.press(event));
    this.setTheme(isDark(viewport.background), false);
  }

  setTheme(dark: boolean, remember = true): void {
    document.documentElement.dataset["theme"] = dark ? "dark" : "light";
    document.querySelector("meta[name=theme-color]")!.setAttribute("content", dark ? "#1a2229" : "#e9edf1");
    if (remember) localStorage.setItem("theme", dark ? "dark" : "light");
    this.viewport.setTheme(dark);
  }

  private toggleSound(): void {
    const output = this.output();
    if (!output) return;
    output.muted = !output.muted;
    const button = element("sound");
    setIcon(button, output.muted ? "muted" : "sound");
    button.setAttribute("aria-pressed", String(!output.muted));
    button.setAttribute("aria-label", output.muted ? "Sound off" : "Sound on");
  }

  private toggleMeters(): void {
    const hud = element("hud");
    hud.hidden = !hud.hidden;
    element("meters").setAttribute("aria-expanded", String(!hud.hidden));
  }

  /** The first press asks what to record and starts; the second ends the recording and downloads it. */
  private async record(): Promise<void> {
    const button = element("record");
    try {
      if (this.recording) return await this.finish(button);
      openMenu(button, KINDS.filter((kind) => kind.id !== "glb" || this.avatar.ours).map((kind) => ({
        ...kind, run: () => this.begin(button, kind.id),
      })));
    } catch (error) {
      toast((error as Error).message);
    }
  }

  private begin(button: HTMLElement, kind: Kind): void {
    try {
      const sound = this.output()?.recording.stream ?? new MediaStream();
      this.recording = kind === "webm" ? new VideoRecorder(this.viewport, sound) : new MotionRecorder(this.session, kind, this.avatar);
      button.classList.add("on");
      button.setAttribute("aria-label", "Stop recording");
      toast("Recording. Press the red button to end it.");
    } catch (error) {
      toast((error as Error).message);
    }
  }

  private async finish(button: HTMLElement): Promise<void> {
    const recording = this.recording!;
    this.recording = null;
    button.classList.remove("on");
    button.setAttribute("aria-label", "Record");
    download(await recording.stop());
  }

  private press(event: KeyboardEvent): void {
    const target = event.target as HTMLElement;
    if (event.ctrlKey || event.metaKey || event.altKey || target.tagName === "INPUT" || target.closest("dialog")) return;
    const number = Number(event.key);
    const shown = [...document.querySelectorAll<HTMLElement>(".source:not([hidden])")];
    const button = number ? shown[number - 1] : document.getElementById(KEYS[event.key] ?? "");
    button?.click();
  }
}

/** What a chosen stage needs to be read on, else what the visitor chose before, else what the system prefers. */
function isDark(background: string): boolean {
  if (background in STAGES) return background === "dusk";
  const chosen = localStorage.getItem("theme");
  return chosen ? chosen === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
}
