declare module "three/examples/jsm/libs/basis/basis_transcoder.js" {
  interface KTX2File {
    isValid(): boolean;
    startTranscoding(): boolean;
    getImageTranscodedSizeInBytes(level: number, layer: number, face: number, format: number): number;
    transcodeImage(to: Uint8Array, level: number, layer: number, face: number, format: number, flags: number, first: number, second: number): number;
    close(): void;
    delete(): void;
  }
  export interface Transcoder {
    initializeBasis(): void;
    readonly KTX2File: new (data: Uint8Array) => KTX2File;
  }
  export default function BASIS(options: { wasmBinary: ArrayBuffer }): Promise<Transcoder>;
}
