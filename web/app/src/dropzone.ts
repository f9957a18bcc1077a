/** Handles dropped or chosen files: an avatar or a sound. */

import type { AvatarSlot } from "./avatars.js";
import { toast } from "./notices.js";
import type { SourceBar } from "./sourcebar.js";

export function connectDrop(avatar: AvatarSlot, sources: SourceBar): void {
  const curtain = document.getElementById("drop")!;
  let depth = 0;
  const show = (change: number) => {
    depth = Math.max(0, depth + change);
    curtain.hidden = depth === 0;
  };
  const open = (file: File) => {
    const opened = /\.(vrm|glb)$/i.test(file.name) ? wear(avatar, file) : sources.play(file);
    opened.catch((error: Error) => toast(error.message));
  };
  sources.onFile = open;
  window.addEventListener("dragenter", (event) => event.dataTransfer?.types.includes("Files") && show(1));
  window.addEventListener("dragleave", () => show(-1));
  window.addEventListener("dragover", (event) => event.preventDefault());
  window.addEventListener("drop", (event) => {
    event.preventDefault();
    show(-depth);
    const file = event.dataTransfer?.files[0];
    if (file) open(file);
  });
}

async function wear(avatar: AvatarSlot, file: File): Promise<void> {
  try {
    await avatar.load(await file.arrayBuffer());
  } catch (error) {
    throw new Error(`“${file.name}” could not be worn: ${(error as Error).message}`);
  }
}
