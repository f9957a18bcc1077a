/** Records what is seen and heard to WebM, and offers files for download. */

const TYPES = ["video/webm;codecs=vp9,opus", "video/webm;codecs=vp8,opus", "video/webm", "video/mp4"];
const BITS = 6_000_000;

export class VideoRecorder {
  private readonly parts: Blob[] = [];
  private readonly recorder: MediaRecorder;

  constructor(canvas: HTMLCanvasElement, sound: MediaStream) {
    const type = TYPES.find((candidate) => MediaRecorder.isTypeSupported(candidate));
    if (!type) throw new Error("This browser cannot record video.");
    const stream = new MediaStream([...canvas.captureStream(30).getVideoTracks(), ...sound.getAudioTracks()]);
    this.recorder = new MediaRecorder(stream, { mimeType: type, videoBitsPerSecond: BITS });
    this.recorder.ondataavailable = ({ data }) => data.size && this.parts.push(data);
    this.recorder.start(1000);
  }

  /** Ends the recording and gives it back. */
  stop(): Promise<File> {
    const { recorder } = this;
    return new Promise((resolve) => {
      recorder.onstop = () => {
        const type = recorder.mimeType.split(";")[0]!;
        resolve(new File(this.parts, `echoavatar.${type.endsWith("mp4") ? "mp4" : "webm"}`, { type }));
      };
      recorder.stop();
    });
  }
}

/** Hands a file to the visitor. */
export function download(file: File): void {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(file);
  link.download = file.name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 60_000);
}
