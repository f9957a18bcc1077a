/** The pages' line icons, 24 x 24. */

import { s } from "./dom.js";

const PATHS = {
  play: "M7 4.5v15l12-7.5z",
  pause: "M7 5v14M17 5v14",
  again: "M4.5 12a7.5 7.5 0 1 0 2.5-5.600M4.5 3.5v4h4",
  loop: "M17 3l3 3-3 3M20 6H8a4 4 0 0 0-4 4v1M7 21l-3-3 3-3M4 18h12a4 4 0 0 0 4-4v-1",
  sound: "M4 9.5v5h3.5L12 18.5v-13L7.5 9.5zM15.5 9a4.200 4.200 0 0 1 0 6M18 6.5a7.800 7.800 0 0 1 0 11",
  muted: "M4 9.5v5h3.5L12 18.5v-13L7.5 9.5zM16 9.5l5 5m0-5-5 5",
  left: "M15 5l-7 7 7 7",
  right: "M9 5l7 7-7 7",
  closer: "M12 5v14M5 12h14",
  farther: "M5 12h14",
  reset:
    "M3 8V5.5A2.5 2.5 0 0 1 5.5 3H8M16 3h2.5A2.5 2.5 0 0 1 21 5.5V8M21 16v2.5a2.5 2.5 0 0 1-2.5 2.5H16M8 21H5.5A2.5 2.5 0 0 1 3 18.5V16M12 11v2M11 12h2",
  best: "M12 3.5l2.600 5.400 5.900.8-4.300 4.100 1.100 5.900-5.300-2.900-5.300 2.900 1.100-5.900L3.5 9.700l5.900-.8z",
  worst: "M12 5v13M6 12.5l6 6 6-6",
  tick: "M5 12.5l4.5 4.5L19 7",
  help: "M9.600 9.5a2.5 2.5 0 1 1 3.600 2.300c-.8.400-1.200.9-1.200 1.800M12 16.700v.1M12 3.5a8.5 8.5 0 1 0 0 17a8.5 8.5 0 1 0 0-17",
  menu: "M5 7h14M5 12h14M5 17h14",
} as const;

export type Icon = keyof typeof PATHS;

export function icon(name: Icon): SVGElement {
  return s(
    "svg",
    { viewBox: "0 0 24 24", class: `icon ${name}`, "aria-hidden": "true" },
    s("path", { d: PATHS[name] }),
  );
}
