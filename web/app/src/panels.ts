/** The panels beside the avatar: one is open at a time, and the camera keeps face and hands out of them. */

/** And the button that opens each. */
const PANELS = { hud: "#meters", manner: "#gestures", talk: "[data-source=chat]", typed: "[data-source=text]" } as const;
export type Panel = keyof typeof PANELS;
const element = (id: string) => document.getElementById(id)!;

/** Opens a panel and closes the others, or closes it; returns whether it is open. */
export function toggle(name: Panel, open = element(name).hidden !== false): boolean {
  for (const [other, button] of Object.entries(PANELS)) {
    element(other).hidden = other !== name || !open;
    document.querySelector(button)!.setAttribute("aria-expanded", String(!element(other).hidden));
  }
  return open;
}

/** CSS pixels at each edge of the window that something covers. */
export interface Covered {
  readonly top: number;
  readonly right: number;
  readonly bottom: number;
  readonly left: number;
}

const COVERING = ["#hud", "#manner", "#talk", "#typed", "#actions", "#menu", "#subtitle:not(.off, :empty)", ".dock", ".top", ".welcome:not(.gone)"];
const MOST = 0.34; // of a side, on the average of both edges, that panels may take

/** How far panels reach in from the edges: wide ones from above or below, the others from the side. */
export function covered(): Covered {
  const out = { top: 0, right: 0, bottom: 0, left: 0 };
  for (const node of document.querySelectorAll(COVERING.join())) {
    const box = node.getBoundingClientRect();
    const isWide = box.left < innerWidth / 2 && box.right > innerWidth / 2;
    if (!box.width || !node.checkVisibility({ visibilityProperty: true })) continue;
    if (node.id === "subtitle" && !isWide) continue; // a word in the corner
    if (isWide && box.top < innerHeight / 4) out.top = Math.max(out.top, box.bottom);
    else if (isWide) out.bottom = Math.max(out.bottom, innerHeight - box.top);
    else if (box.right < innerWidth / 2) out.left = Math.max(out.left, box.right);
    else out.right = Math.max(out.right, innerWidth - box.left);
  }
  const high = Math.min(1, (2 * MOST * innerHeight) / (out.top + out.bottom || 1));
  const wide = Math.min(1, (2 * MOST * innerWidth) / (out.left + out.right || 1));
  return { top: out.top * high, bottom: out.bottom * high, left: out.left * wide, right: out.right * wide };
}
