/** Sound sources: bundled sound, files, the microphone, another tab. */

import { decodeSound } from "@echoavatar/client";

/** The bytes of a chosen file; throws an error that names it. */
export function bytesOf(file: File): Promise<ArrayBuffer> {
  return file.arrayBuffer().catch((error: Error) => {
    throw new Error(`“${file.name}” cannot be read (${error.message}). Choose it again.`);
  });
}

export async function fetchSound(url: string, rate: number): Promise<Float32Array> {
  const response = await fetch(url);
  if (!response.ok) throw new Error(`${url} is not there (${response.status}).`);
  return decodeSound(await response.arrayBuffer(), rate);
}

/** Shows how loud captured sound is, on the button that captures it. */
export function showLevel(button: HTMLElement): (block: Float32Array) => void {
  return (block) => {
    const power = block.reduce((sum, value) => sum + value * value, 0) / block.length;
    button.style.setProperty("--level", String(Math.min(1, Math.max(0, 1 + Math.log10(power + 1e-9) / 5)).toFixed(2))); // -50 dB is none
  };
}

export function openMicrophone(): Promise<MediaStream> {
  if (!navigator.mediaDevices?.getUserMedia) throw new Error("The microphone needs https:// or localhost.");
  return navigator.mediaDevices.getUserMedia({
    audio: { echoCancellation: true, noiseSuppression: true, autoGainControl: true },
  });
}

/** Captures another tab. Where the browser allows it, that tab is muted and its sound plays here, in sync. */
export async function openTab(): Promise<MediaStream> {
  const stream = await navigator.mediaDevices.getDisplayMedia({
    video: true,
    audio: { suppressLocalAudioPlayback: true, echoCancellation: false, noiseSuppression: false, autoGainControl: false } as MediaTrackConstraints,
  });
  for (const track of stream.getVideoTracks()) track.enabled = false;
  if (stream.getAudioTracks().length) return stream;
  for (const track of stream.getTracks()) track.stop();
  throw new Error("That share has no sound: choose a tab and tick “Also share tab audio”.");
}

export const canShareTabs = () => !!navigator.mediaDevices?.getDisplayMedia && !matchMedia("(pointer: coarse)").matches;
