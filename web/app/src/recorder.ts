/** Records picture and sound to WebM, or motion alone, and offers the file for download. */

import type { EchoSession } from "@echoavatar/client";
import { Take, toBvh, toGlb, toVrma } from "@echoavatar/client/export";
import fixWebmDuration from "fix-webm-duration";
import type { AvatarSlot } from "./avatars.js";
import type { Viewport } from "./viewport.js";

const TYPES = ["video/webm;codecs=vp9,opus", "video/webm;codecs=vp8,opus", "video/webm", "video/mp4"];
const BITS = 8_000_000;
const [LONG, SHORT] = [1920, 1080]; // pixels; upright where the window is

export class VideoRecorder {
  private readonly parts: Blob[] = [];
  private readonly recorder: MediaRecorder;

  private readonly begun = performance.now();

  constructor(private readonly viewport: Viewport, sound: MediaStream) {
    const type = TYPES.find((candidate) => MediaRecorder.isTypeSupported(candidate));
    if (!type) throw new Error("This browser cannot record video.");
    const isUpright = innerHeight > innerWidth;
    viewport.fix({ width: isUpright ? SHORT : LONG, height: isUpright ? LONG : SHORT });
    const stream = new MediaStream([...viewport.canvas.captureStream(30).getVideoTracks(), ...sound.getAudioTracks()]);
    this.recorder = new MediaRecorder(stream, { mimeType: type, videoBitsPerSecond: BITS });
    this.recorder.ondataavailable = ({ data }) => data.size && this.parts.push(data);
    this.recorder.start(1000);
  }

  /** Ends the recording and returns it. */
  stop(): Promise<File> {
    const { recorder } = this;
    return new Promise((resolve) => {
      const milliseconds = performance.now() - this.begun;
      recorder.onstop = async () => {
        const type = recorder.mimeType.split(";")[0]!;
        const blob = new Blob(this.parts, { type });
        if (type.endsWith("mp4")) return resolve(new File([blob], "echoavatar.mp4", { type }));
        const whole = await fixWebmDuration(blob, milliseconds, { logger: false }); // browsers write none
        resolve(new File([whole], "echoavatar.webm", { type }));
      };
      recorder.stop();
      this.viewport.fix(null);
    });
  }
}

export type MotionKind = "bvh" | "glb" | "vrma";

/** Records every frame that is played, also while the tab is hidden. */
export class MotionRecorder {
  private readonly take: Take;
  private readonly player;

  constructor(session: EchoSession, private readonly kind: MotionKind, private readonly avatar: AvatarSlot) {
    if (!session.ready || !session.player) throw new Error("Nothing moves yet.");
    this.take = new Take(session.ready);
    this.player = session.player;
    this.player.onFrame = (pose) => this.take.add(pose);
  }

  async stop(): Promise<File> {
    this.player.onFrame = null;
    if (!this.take.frames.length) throw new Error("Nothing was recorded.");
    const { kind, take } = this;
    const content = kind === "bvh" ? toBvh(take) : kind === "vrma" ? toVrma(take) : toGlb(take, await this.avatar.file());
    return new File([content], `echoavatar.${kind}`);
  }
}

/** Starts a file download. */
export function download(file: File): void {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(file);
  link.download = file.name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 60_000);
}
