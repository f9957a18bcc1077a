/** KTX2 textures (Basis Universal): a worker unpacks them, because three's transcoder evaluates code and the page may not. */

import { DataTexture, FileLoader, Loader, type LoadingManager } from "three";
import wasm from "three/examples/jsm/libs/basis/basis_transcoder.wasm?url";
import script from "./transcode?worker&url";
import type { Unpacked } from "./transcode.js";

const PATIENCE_MS = 30_000; // for one picture
type Given = (texture: DataTexture) => void;
type Failed = (error: unknown) => void;

/** Fetches the transcoder and starts the worker. */
export async function openBasis(manager: LoadingManager): Promise<Basis> {
  const answer = await fetch(wasm);
  if (!answer.ok) throw new Error(`the reader of KTX2 textures is not there (${answer.status})`);
  return new Basis(manager, await answer.arrayBuffer());
}

/** Has what GLTFLoader uses of three's KTX2Loader. */
class Basis extends Loader<DataTexture> {
  readonly isKTX2Loader = true;
  /** The first error; GLTFLoader shows the surface without its picture and tells no one. */
  fault: Error | null = null;
  private readonly worker = new Worker(script, { type: "module" });
  private last: Promise<unknown> = Promise.resolve();

  constructor(manager: LoadingManager, transcoder: ArrayBuffer) {
    super(manager);
    this.worker.postMessage(transcoder, [transcoder]);
  }

  override load(url: string, onLoad: Given, onProgress?: (event: ProgressEvent) => void, onError?: Failed): void {
    const files = new FileLoader(this.manager).setResponseType("arraybuffer");
    files.load(url, (data) => this.parse(data as ArrayBuffer, onLoad, onError), onProgress, onError);
  }

  parse(data: ArrayBuffer, onLoad: Given, onError?: Failed): void {
    const made = this.last.then(() => { // one after the other, and none after a fault
      if (this.fault) throw this.fault;
      return this.unpack(data);
    });
    this.last = made.catch((error: Error) => {
      this.fault ??= new Error(`one of its KTX2 textures ${error.message}. Export it again, or as PNG or JPEG.`);
    });
    made.then(onLoad, onError);
  }

  dispose(): void {
    this.worker.terminate();
  }

  private unpack(data: ArrayBuffer): Promise<DataTexture> {
    const { worker } = this;
    return new Promise((resolve, reject) => {
      const late = setTimeout(() => reject(new Error(`was not unpacked in ${PATIENCE_MS / 1000} s`)), PATIENCE_MS);
      worker.onerror = ({ message }) => reject(new Error(`stopped its reader (${message})`));
      worker.onmessage = ({ data: { pixels, width, height, fault } }: MessageEvent<Unpacked>) => {
        clearTimeout(late);
        if (fault) return reject(new Error(fault));
        const texture = new DataTexture(pixels, width, height);
        texture.needsUpdate = true;
        resolve(texture);
      };
      worker.postMessage(data, [data]);
    });
  }
}
