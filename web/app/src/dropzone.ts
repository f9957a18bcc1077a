/** Handles dropped or chosen files: an avatar, whose parts may be in files of their own, or a sound. */

import { toast } from "./notices.js";
import { bytesOf } from "./sources.js";
import type { SourceBar } from "./sourcebar.js";
import type { Wardrobe } from "./wardrobe.js";

export function connectDrop(wardrobe: Wardrobe, sources: SourceBar): void {
  const curtain = document.getElementById("drop")!;
  let depth = 0;
  const show = (change: number) => {
    depth = Math.max(0, depth + change);
    curtain.hidden = depth === 0;
  };
  const open = (files: readonly File[]) => {
    const worn = files.find((file) => /\.(vrm|glb|gltf)$/i.test(file.name));
    const opened = worn ? wear(wardrobe, worn, files) : files[0] && sources.play(files[0]);
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

async function wear(wardrobe: Wardrobe, file: File, files: readonly File[]): Promise<void> {
  await wardrobe.wear(file.name, await bytesOf(file), new Map(files.map((part) => [part.name, part])));
}
