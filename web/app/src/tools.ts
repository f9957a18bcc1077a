/** The round buttons at the top and their keyboard shortcuts. */

import type { EchoSession, Output } from "@echoavatar/client";
import { STAGES, type StageName, VIEWS } from "@echoavatar/client/three";
import type { AvatarSlot } from "./avatars.js";
import { setIcon } from "./icons.js";
import { type Choice, openMenu, toast } from "./notices.js";
import { toggle } from "./panels.js";
import type { MotionKind } from "./recorder.js";
import type { Viewport } from "./viewport.js";
import { type Wardrobe, remember } from "./wardrobe.js";

const element = <Kind extends HTMLElement>(id: string) => document.getElementById(id) as Kind;
type Kind = MotionKind | "webm";
const KINDS: readonly { id: Kind; label: string; hint: string }[] = [
  { id: "webm", label: "Video with sound", hint: "WebM, 1920 × 1080, upright on an upright screen" },
  { id: "glb", label: "The moving character", hint: "GLB, for Blender, Unity, Unreal, Godot" },
  { id: "vrma", label: "Motion for VRM avatars", hint: "VRMA, body and face" },
  { id: "bvh", label: "Motion capture file", hint: "BVH, body" },
];
const LIGHTS: Readonly<Record<StageName, string>> = { studio: "Studio", dusk: "Dusk", plain: "White" };
const KEYS: Record<string, string> = { a: "avatar", g: "gestures", m: "sound", l: "meters", r: "record", "?": "help", Escape: "stop" };

export class Tools {
  private recording: { stop(): Promise<File> } | null = null;
  private stage: StageName = "studio";

  constructor(
    private readonly viewport: Viewport,
    private readonly session: EchoSession,
    private readonly avatar: AvatarSlot,
    wardrobe: Wardrobe,
    private readonly output: () => Output | null,
    private readonly settings: URLSearchParams,
  ) {
    element("avatar").onclick = () => void wardrobe.look().then(() => openMenu(element("avatar"), wardrobe.choices));
    element("look").onclick = () => openMenu(element("look"), this.looks);
    element("sound").onclick = () => this.toggleSound();
    element("meters").onclick = () => toggle("hud");
    element("gestures").onclick = () => toggle("manner");
    element("record").onclick = () => void this.record();
    element("help").onclick = () => element<HTMLDialogElement>("about").showModal();
    window.addEventListener("keydown", (event) => this.press(event));
    this.setStage(firstStage(settings.get("background") ?? ""));
    const view = VIEWS.findIndex(({ id }) => id === settings.get("view"));
    if (view >= 0) viewport.choose(view);
  }

  private setStage(stage: StageName): void {
    this.stage = stage;
    const dark = stage === "dusk";
    document.documentElement.dataset["theme"] = dark ? "dark" : "light";
    document.querySelector("meta[name=theme-color]")!.setAttribute("content", dark ? "#1a2229" : "#e9edf1");
    this.viewport.setStage(stage);
  }

  private chooseStage(stage: StageName): void {
    this.setStage(stage);
    localStorage.setItem("stage", stage);
    if (this.settings.get("background") !== "clear") remember("background", "");
  }

  /** The camera, the light, and how much is drawn. */
  private get looks(): Choice[] {
    const { viewport, settings } = this;
    const view = (index: number | null, id: string, label: string) => ({
      id, label, on: viewport.chosen === index, run: () => (viewport.choose(index), remember("view", index === null ? "" : id)),
    });
    const quality = settings.get("quality") ?? "";
    const drawn = (id: string, label: string) => ({ id: `quality-${id}`, label, on: quality === id, run: () => reload("quality", id) });
    const isClear = settings.get("background") === "clear";
    return [
      { ...view(null, "follow", "As it suits"), under: "Camera" },
      ...VIEWS.map(({ id, label }, index) => view(index, id, label)),
      ...(Object.keys(LIGHTS) as StageName[]).map((id, index) => ({
        id, label: LIGHTS[id], on: this.stage === id && !isClear, run: () => (isClear ? reload("background", id) : this.chooseStage(id)), ...(index ? {} : { under: "Light" }),
      })),
      { id: "clear", label: "No backdrop", hint: "For OBS and other programs that show this page over a picture", on: isClear, run: () => reload("background", "clear") },
      { ...drawn("", "As quick as it can be"), under: "Drawing" },
      drawn("high", "Everything"),
      drawn("low", "The least"),
    ];
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

  /** The first press asks what to record and starts; the second ends the recording and downloads it. */
  private async record(): Promise<void> {
    const button = element("record");
    try {
      if (this.recording) return await this.finish(button);
      openMenu(button, KINDS.filter((kind) => kind.id !== "glb" || this.avatar.ours).map((kind) => ({
        ...kind, run: () => void this.begin(button, kind.id),
      })));
    } catch (error) {
      toast((error as Error).message);
    }
  }

  private async begin(button: HTMLElement, kind: Kind): Promise<void> {
    try {
      const { MotionRecorder, VideoRecorder } = await import("./recorder.js"); // most visits need none
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
    const { download } = await import("./recorder.js");
    download(await recording.stop());
  }

  private press(event: KeyboardEvent): void {
    const target = event.target as HTMLElement;
    if (event.ctrlKey || event.metaKey || event.altKey || target.tagName === "INPUT" || target.closest("dialog")) return;
    if (event.key === "c") return this.viewport.nextView();
    if (event.key === "t") return this.chooseStage(this.stage === "dusk" ? "studio" : "dusk");
    const number = Number(event.key);
    const shown = [...document.querySelectorAll<HTMLElement>(".source:not([hidden])")];
    const button = number ? shown[number - 1] : document.getElementById(KEYS[event.key] ?? "");
    button?.click();
  }
}

/** The stage of the address, else what the visitor chose before, else what the system prefers. */
function firstStage(asked: string): StageName {
  const found = [asked, localStorage.getItem("stage") ?? ""].find((name): name is StageName => name in STAGES);
  return found ?? (matchMedia("(prefers-color-scheme: dark)").matches ? "dusk" : "studio");
}

/** Changes what only a new page can change. */
function reload(name: string, value: string): void {
  remember(name, value);
  location.reload();
}
