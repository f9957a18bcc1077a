/** Fetches a task's files once, and the next task's files while this one is judged. */

import type { Api } from "../api.js";
import type { RaterTask, Scene } from "../api.generated.js";
import { type RetryOptions, retry } from "../retry.js";
import { Clip } from "./clip.js";
import { decode } from "./sound.js";

export interface Media {
  readonly sound: AudioBuffer;
  readonly clips: readonly Clip[];
}

export class Library {
  private readonly files = new Map<string, Promise<ArrayBuffer>>();

  constructor(
    private readonly api: Api,
    readonly scene: Scene,
  ) {}

  /** Loads a task's files; `onPart` reports progress. Throws errors that a retry cannot fix. */
  async load(task: RaterTask, onPart: (share: number) => void, insisting: RetryOptions): Promise<Media> {
    const addresses = [task.audio, ...task.clips];
    let here = 0;
    const files = await Promise.all(
      addresses.map(async (address) => {
        const bytes = await retry(() => this.file(address), insisting);
        onPart(++here / addresses.length);
        return bytes;
      }),
    );
    const sound = await decode(files[0]!.slice(0)); // decoding detaches the buffer
    return { sound, clips: files.slice(1).map((bytes) => new Clip(bytes, this.scene)) };
  }

  /** Prefetches; a failed file is fetched again when needed. Files of other tasks are dropped. */
  ahead(current: RaterTask, next: RaterTask | null): void {
    const wanted = [current, next].flatMap((task) => (task ? [task.audio, ...task.clips] : []));
    for (const address of this.files.keys()) if (!wanted.includes(address)) this.files.delete(address);
    for (const address of wanted) void this.file(address).catch(() => undefined);
  }

  private file(address: string): Promise<ArrayBuffer> {
    const known = this.files.get(address);
    if (known) return known;
    const coming = this.api.bytes(address);
    coming.catch(() => this.files.delete(address));
    this.files.set(address, coming);
    return coming;
  }
}
