/** Handles dropped or chosen files: an avatar, whose parts may be in files of their own, or a sound. */

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
  const open = (files: readonly File[]) => {
    const worn = files.find((file) => /\.(vrm|glb|gltf)$/i.test(file.name));
    const opened = worn ? wear(avatar, worn, files) : files[0] && sources.play(files[0]);
    opened?.catch((error: Error) => toast(error.message));
  };
  sources.onFiles = open;
  window.addEventListener("dragenter", (event) => event.dataTransfer?.types.includes("Files") && show(1));
  window.addEventListener("dragleave", () => show(-1));
  window.addEventListener("dragover", (event) => event.preventDefault());
  window.addEventListener("drop", (event) => {
    event.preventDefault();
    show(-depth);
    open([...(event.dataTransfer?.files ?? [])]);
  });
}

async function wear(avatar: AvatarSlot, file: File, files: readonly File[]): Promise<void> {
  try {
    await avatar.load(await file.arrayBuffer(), new Map(files.map((part) => [part.name, part])));
    const still = avatar.driver?.silent ?? [];
    if (still.length) toast(`Nothing on the face of “${file.name}” shows ${told(still)}.`);
  } catch (error) {
    throw new Error(`“${file.name}” could not be worn: ${(error as Error).message}`);
  }
}

const TOLD = 6; // curves that a notice names

function told(names: readonly string[]): string {
  const more = names.length - TOLD;
  return names.slice(0, TOLD).join(", ") + (more > 0 ? ` and ${more} more` : "");
}
