/** Toasts, menus, and the subtitle that names what the avatar does. */

import { covered } from "./panels.js";

const element = (id: string) => document.getElementById(id)!;
const TOAST_MS = 5200;

export function toast(text: string): void {
  const box = document.createElement("div");
  box.className = "toast";
  box.textContent = text;
  element("toasts").replaceChildren(box);
  element("toasts").style.bottom = `${covered().bottom + 10}px`; // above what can be pressed
  setTimeout(() => box.remove(), TOAST_MS);
}

export interface Choice {
  readonly id?: string;
  readonly label: string;
  readonly hint?: string;
  /** Address of a small picture before the label. */
  readonly picture?: string;
  /** Whether it is what is chosen now, where the menu tells. */
  readonly on?: boolean;
  /** A heading over this choice and those that follow. */
  readonly under?: string;
  readonly run: () => void;
}

/** A small menu above or below `anchor`; closed by Escape, a click elsewhere or a choice. */
export function openMenu(anchor: HTMLElement, choices: readonly Choice[]): void {
  const menu = element("menu");
  const close = () => {
    menu.hidden = true;
    menu.replaceChildren();
    document.removeEventListener("pointerdown", outside, true);
    document.removeEventListener("keydown", keys, true);
  };
  const outside = (event: Event) => {
    if (!menu.contains(event.target as Node)) close();
  };
  const keys = (event: KeyboardEvent) => {
    const buttons = [...menu.querySelectorAll("button")];
    const at = buttons.indexOf(document.activeElement as HTMLButtonElement);
    if (event.key === "Escape") {
      close();
      anchor.focus();
    } else if (event.key === "ArrowDown" || event.key === "ArrowUp") {
      buttons.at((at + (event.key === "ArrowDown" ? 1 : -1)) % buttons.length)?.focus();
    } else return;
    event.preventDefault();
    event.stopPropagation();
  };
  menu.replaceChildren(...choices.flatMap((choice) => [heading(choice), entry(choice, close)].filter((part) => part !== null)));
  menu.hidden = false;
  place(menu, anchor);
  (menu.querySelector<HTMLElement>("[aria-checked=true]") ?? menu.querySelector("button"))?.focus({ preventScroll: true });
  document.addEventListener("pointerdown", outside, true);
  document.addEventListener("keydown", keys, true);
}

function heading({ under }: Choice): HTMLElement | null {
  return under ? Object.assign(document.createElement("h3"), { textContent: under }) : null;
}

function entry({ id, label, hint, picture, on, run }: Choice, close: () => void): HTMLElement {
  const button = document.createElement("button");
  button.setAttribute("role", on === undefined ? "menuitem" : "menuitemradio");
  if (on !== undefined) button.setAttribute("aria-checked", String(on));
  if (id) button.dataset["choice"] = id;
  if (picture) {
    const image = Object.assign(document.createElement("img"), { src: picture, alt: "" });
    image.onerror = () => image.remove();
    button.append(image);
  }
  const words = Object.assign(document.createElement("span"), { textContent: label });
  if (hint) words.append(Object.assign(document.createElement("small"), { textContent: hint }));
  button.append(words);
  button.onclick = () => {
    close();
    run();
  };
  return button;
}

function place(menu: HTMLElement, anchor: HTMLElement): void {
  const at = anchor.getBoundingClientRect();
  menu.style.left = "0"; // the last place leaves too little room to measure in
  const [width, height] = [menu.offsetWidth, menu.offsetHeight];
  const above = at.top - height - 14;
  const isAbove = above > 12; // the dock's menus reach away from the body, those of the top hang at the edge beside it
  menu.classList.toggle("above", isAbove);
  menu.style.left = `${Math.max(12, (isAbove ? at.right : innerWidth - 12) - width)}px`;
  menu.style.top = `${isAbove ? above : at.bottom + 8}px`;
}

/** Shows what the avatar is doing until it ends. */
export function subtitle(text: string): void {
  const box = element("subtitle");
  if (text) box.textContent = text;
  box.classList.toggle("off", !text);
}
