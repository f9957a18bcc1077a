/** The backdrops of the film. Do not edit: scripts/make_stages.py makes it of the film's backdrop.py. */

export type Triple = readonly [number, number, number];

/** Directions are unit vectors, light is linear, backdrops are sRGB from 0 to 1. */
export interface Stage {
  readonly direction: Triple; // to the key light
  readonly key: Triple;
  readonly sky: Triple;
  readonly ground: Triple;
  readonly behind: Triple; // direction to the light from behind
  readonly rim: Triple;
  readonly top: Triple;
  readonly horizon: Triple;
  readonly bottom: Triple;
  readonly shadow: readonly [cast: number, contact: number];
}

export const TONE = [2.51, 0.03, 2.43, 0.59, 0.14] as const; // x (a x + b) / (x (c x + d) + e)

export const STAGES = {
  studio: {
    direction: [0.3502, 0.7441, 0.569],
    key: [0.8, 0.745, 0.68],
    sky: [0.4, 0.42, 0.46],
    ground: [0.2, 0.18, 0.165],
    behind: [-0.528, 0.624, -0.576],
    rim: [0.3, 0.34, 0.4],
    top: [0.8706, 0.8863, 0.9059],
    horizon: [0.9333, 0.9412, 0.949],
    bottom: [0.8392, 0.8471, 0.8588],
    shadow: [0.3, 0.45],
  },
  dusk: {
    direction: [0.412, 0.618, 0.6695],
    key: [0.86, 0.68, 0.5],
    sky: [0.24, 0.26, 0.4],
    ground: [0.15, 0.11, 0.12],
    behind: [-0.5758, 0.5234, -0.6281],
    rim: [0.42, 0.4, 0.72],
    top: [0.1098, 0.1176, 0.1882],
    horizon: [0.2902, 0.2431, 0.3216],
    bottom: [0.1725, 0.149, 0.1961],
    shadow: [0.45, 0.55],
  },
  plain: {
    direction: [0.3502, 0.7441, 0.569],
    key: [0.8, 0.745, 0.68],
    sky: [0.4, 0.42, 0.46],
    ground: [0.2, 0.18, 0.165],
    behind: [-0.528, 0.624, -0.576],
    rim: [0.3, 0.34, 0.4],
    top: [1.0, 1.0, 1.0],
    horizon: [1.0, 1.0, 1.0],
    bottom: [1.0, 1.0, 1.0],
    shadow: [0.22, 0.4],
  },
} as const satisfies Record<string, Stage>;
