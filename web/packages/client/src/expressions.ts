/** Maps ARKit curves to the expressions of a VRM that has only vowels, blinks and looks; mirrors `motion/arkit.py`. */

export const VRM_EXPRESSIONS = [
  "aa", "ih", "ou", "ee", "oh", "blink", "blinkLeft", "blinkRight", "lookUp", "lookDown", "lookLeft", "lookRight",
] as const;

type Get = (name: string) => number;
const clip = (x: number) => Math.min(1, Math.max(0, x));

/** The twelve weights in the order of `VRM_EXPRESSIONS`; the vowels sum to at most 1. */
export function toVrm(get: Get): number[] {
  const pair = (name: string) => (get(`${name}Left`) + get(`${name}Right`)) / 2;
  const opening = clip(get("jawOpen") - get("mouthClose"));
  const [funnel, pucker] = [get("mouthFunnel"), get("mouthPucker")];
  const width = Math.max(pair("mouthStretch"), pair("mouthSmile"), pair("mouthDimple"));
  const round = clip(funnel + pucker);
  const wide = clip(2 * width) * (1 - round);
  const parted = Math.min(1, 6 * opening);
  const vowels = [
    1.6 * opening * (1 - round) * (1 - 0.6 * wide),
    1.2 * opening * (1 - round) * 0.4 * wide + 0.25 * wide * parted,
    clip(pucker) * (1 - 0.5 * opening),
    1.2 * opening * wide + 0.3 * wide * parted,
    1.4 * opening * round + 0.5 * funnel * (1 - clip(pucker)),
  ];
  const total = Math.max(1, vowels.reduce((sum, x) => sum + x, 0));
  const [left, right] = [clip(get("eyeBlinkLeft")), clip(get("eyeBlinkRight"))];
  const both = Math.min(left, right);
  const eyes = [
    both, left - both, right - both,
    pair("eyeLookUp"), pair("eyeLookDown"),
    (get("eyeLookOutLeft") + get("eyeLookInRight")) / 2,
    (get("eyeLookInLeft") + get("eyeLookOutRight")) / 2,
  ];
  return [...vowels.map((x) => x / total), ...eyes].map(clip);
}
