/** The worker that unpacks KTX2 textures. The server lets this script, and no other, evaluate code (`server/page.py`). */

import BASIS, { type Transcoder } from "three/examples/jsm/libs/basis/basis_transcoder.js";

/** What comes back of a picture: its pixels (RGBA), or what is wrong with it. */
export interface Unpacked {
  readonly pixels: Uint8Array<ArrayBuffer>;
  readonly width: number;
  readonly height: number;
  readonly fault: string;
}

const MAGIC = "\u00abKTX 20\u00bb\r\n\x1a\n";
const HEAD = 104; // bytes, with the entry of one level
const MOST_SIDE = 8192; // pixels, which every graphics card takes
const MOST_PIXELS = 2 ** 28; // of a file's pictures together: 1 GiB
const RGBA = 13; // the transcoder's number of the format
let transcoder: Promise<Transcoder> | null = null;
let left = MOST_PIXELS;

self.onmessage = async ({ data }: MessageEvent<ArrayBuffer>) => {
  if (!transcoder) return void (transcoder = BASIS({ wasmBinary: data }));
  try {
    const { width, height } = checked(data);
    const pixels = unpacked(await transcoder, data, width, height);
    self.postMessage({ pixels, width, height, fault: "" } satisfies Unpacked, { transfer: [pixels.buffer] });
  } catch (error) {
    const fault = error instanceof Fault ? error.message : `is damaged (${String(error)})`;
    self.postMessage({ pixels: new Uint8Array(0), width: 0, height: 0, fault } satisfies Unpacked);
  }
};

class Fault extends Error {}

/** The size that the header states, after a look at all that the transcoder would believe. */
function checked(data: ArrayBuffer): { width: number; height: number } {
  const view = new DataView(data);
  const letters = String.fromCharCode(...new Uint8Array(data.slice(0, 12)));
  if (data.byteLength < HEAD || letters !== MAGIC) throw new Fault("is not KTX2");
  const [format, width, height, depth, layers, faces, levels, scheme] = [12, 20, 24, 28, 32, 36, 40, 44].map((at) => view.getUint32(at, true)) as
    [number, number, number, number, number, number, number, number];
  if (format || scheme > 2) throw new Fault("is not in Basis Universal, the one format that glTF has in KTX2");
  if (depth || layers > 1 || faces !== 1 || levels > 14) throw new Fault("is not a flat picture");
  if (Math.min(width, height) < 1 || Math.max(width, height) > MOST_SIDE) throw new Fault(`has ${width} x ${height} pixels, and at most ${MOST_SIDE} a side are shown`);
  if ((left -= width * height) < 0) throw new Fault(`is too many: ${MOST_PIXELS} pixels together are shown`);
  const [start, length, whole] = [80, 88, 96].map((at) => Number(view.getBigUint64(at, true))) as [number, number, number];
  if (start + length > data.byteLength) throw new Fault(`is cut off after ${data.byteLength} of ${start + length} bytes`);
  if (scheme === 2 && whole > 16 * Math.ceil(width / 4) * Math.ceil(height / 4)) throw new Fault("is damaged (its level is too long)");
  return { width, height };
}

function unpacked({ KTX2File, initializeBasis }: Transcoder, data: ArrayBuffer, width: number, height: number): Uint8Array<ArrayBuffer> {
  initializeBasis();
  const file = new KTX2File(new Uint8Array(data));
  try {
    const pixels = new Uint8Array(4 * width * height);
    const isRead = file.isValid() && file.startTranscoding() && file.getImageTranscodedSizeInBytes(0, 0, 0, RGBA) === pixels.length;
    if (!isRead || !file.transcodeImage(pixels, 0, 0, 0, RGBA, 0, -1, -1)) throw new Fault("is damaged");
    return pixels;
  } finally {
    file.close();
    file.delete();
  }
}
