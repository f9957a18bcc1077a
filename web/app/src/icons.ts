/** The page's line icons, 24 x 24. */

const PATHS: Record<string, string> = {
  avatar: '<circle cx="12" cy="8" r="4"/><path d="M4.500 20c.7-4.300 3.600-6.500 7.500-6.500s6.800 2.200 7.500 6.500"/>',
  camera: '<path d="M3 8V5.500A2.500 2.500 0 0 1 5.500 3H8M16 3h2.500A2.500 2.500 0 0 1 21 5.500V8M21 16v2.500a2.500 2.500 0 0 1-2.500 2.500H16M8 21H5.500A2.500 2.500 0 0 1 3 18.500V16"/><circle cx="12" cy="9.500" r="2.500"/><path d="M7.500 17c.6-2.600 2.300-3.900 4.500-3.900s3.900 1.300 4.500 3.900"/>',
  gestures: '<path d="M8 12V6a1.500 1.500 0 0 1 3 0v5V4.500a1.500 1.500 0 0 1 3 0V11V6a1.500 1.500 0 0 1 3 0v8.500a6 6 0 0 1-11.200 3L4 13.500a1.500 1.500 0 0 1 2.600-1.500L8 14z"/>',
  sound: '<path d="M4 9.500v5h3.500L12 18.500v-13L7.500 9.500z"/><path d="M15.500 9a4.200 4.200 0 0 1 0 6M18 6.500a7.800 7.800 0 0 1 0 11"/>',
  muted: '<path d="M4 9.500v5h3.500L12 18.500v-13L7.500 9.500z"/><path d="m16 9.500 5 5m0-5-5 5"/>',
  meter: '<path d="M3 12h3.500l2.500-7 4.500 14 3-9 1.500 2H21"/>',
  record: '<circle cx="12" cy="12" r="8.500"/><circle cx="12" cy="12" r="3.500"/>',
  help: '<circle cx="12" cy="12" r="8.500"/><path d="M9.600 9.500a2.500 2.500 0 1 1 3.600 2.300c-.8.400-1.200.9-1.200 1.800"/><path d="M12 16.700v.1"/>',
  play: '<path d="M7 4.500v15l12-7.500z"/>',
  stop: '<rect x="5" y="5" width="14" height="14" rx="3"/>',
  speech: '<path d="M4 6.500A2.500 2.500 0 0 1 6.500 4h11A2.500 2.500 0 0 1 20 6.500v7a2.500 2.500 0 0 1-2.500 2.500H11l-4.500 4v-4A2.500 2.500 0 0 1 4 13.500z"/><path d="M8.500 8.500v3M12 7.500v5M15.500 8.500v3"/>',
  music: '<path d="M9 17.500V5.500l10-2v12"/><circle cx="6.500" cy="17.500" r="2.500"/><circle cx="16.500" cy="15.500" r="2.500"/>',
  microphone: '<rect x="9" y="3" width="6" height="11" rx="3"/><path d="M5.500 11.500a6.500 6.500 0 0 0 13 0M12 18v3"/>',
  file: '<path d="M6 3.500h7.500L19 9v11.500H6z"/><path d="M13.500 3.500V9H19M12.500 12v5M10 14.500l2.500-2.500 2.500 2.500" />',
  tab: '<path d="M3 7.500V6a2 2 0 0 1 2-2h5l2 3.500h9V18a2 2 0 0 1-2 2H5a2 2 0 0 1-2-2z"/><path d="M9 12.500v2M12 11v5M15 12.500v2"/>',
  chat: '<path d="M4 5h11v8H9l-3.500 3v-3H4z"/><path d="M18 9h2.500v8H19v3l-3.500-3H10v-1.500"/>',
  text: '<path d="M4 7V5h16v2M12 5v14M9 19h6"/>',
};

/** SVG markup of one icon. */
export function icon(name: string): string {
  return `<svg viewBox="0 0 24 24" aria-hidden="true">${PATHS[name] ?? ""}</svg>`;
}

/** Draws an icon into every element that has `data-icon`. */
export function drawIcons(root: ParentNode = document): void {
  for (const element of root.querySelectorAll<HTMLElement>("[data-icon]")) setIcon(element, element.dataset["icon"]!);
}

export function setIcon(element: HTMLElement, name: string): void {
  element.dataset["icon"] = name;
  element.innerHTML = icon(name);
}
