/** Elements from code: no templates, so nothing that somebody typed is ever read as markup. */

type Child = Node | string | number | null | undefined | false;
type Attribute = string | number | boolean | null | undefined | ((event: Event) => void);

/** An HTML element; `on...` attributes are listeners, `false` and null leave an attribute out. */
export function h<Tag extends keyof HTMLElementTagNameMap>(
  tag: Tag,
  attributes: Record<string, Attribute> = {},
  ...children: Child[]
): HTMLElementTagNameMap[Tag] {
  return fill(document.createElement(tag), attributes, children);
}

/** An SVG element. */
export function s<Tag extends keyof SVGElementTagNameMap>(
  tag: Tag,
  attributes: Record<string, Attribute> = {},
  ...children: Child[]
): SVGElementTagNameMap[Tag] {
  return fill(document.createElementNS("http://www.w3.org/2000/svg", tag), attributes, children);
}

function fill<Kind extends Element>(element: Kind, attributes: Record<string, Attribute>, children: Child[]): Kind {
  for (const [name, value] of Object.entries(attributes)) {
    if (typeof value === "function") element.addEventListener(name.slice(2), value);
    else if (value === true) element.setAttribute(name, "");
    else if (value !== false && value !== null && value !== undefined) element.setAttribute(name, String(value));
  }
  element.append(
    ...children
      .filter((child) => child !== null && child !== undefined && child !== false)
      .map((child) => (child instanceof Node ? child : String(child))),
  );
  return element;
}

/** Plain text of several paragraphs, as paragraphs. */
export function paragraphs(text: string): HTMLElement[] {
  return text.split(/\n\s*\n/).map((part) => h("p", {}, part.trim()));
}

/** The place in the document for the page's content. */
export const root = (): HTMLElement => document.getElementById("page")!;

/** Replaces what is on the page and takes the focus to its heading, so that readers of the screen are told. */
export function show(...children: Node[]): void {
  root().replaceChildren(...children);
  const heading = root().querySelector<HTMLElement>("h1[tabindex], h2[tabindex]");
  heading?.focus({ preventScroll: true });
  window.scrollTo(0, 0);
}

/** Says something to readers of the screen. */
export function say(text: string): void {
  const box = document.getElementById("said");
  if (box) box.textContent = text;
}

const NOTE_MS = 5000;

/** Shows a short note, which is also said. */
export function note(text: string): void {
  document.querySelector(".note")?.remove();
  const box = h("div", { class: "note" }, text);
  document.body.append(box);
  say(text);
  setTimeout(() => box.remove(), NOTE_MS);
}

/** Asks before something that cannot be undone; true when it was confirmed. */
export function ask(question: string, yes: string, no: string, ...more: Node[]): Promise<boolean> {
  return new Promise((resolve) => {
    const dialog = h(
      "dialog",
      { class: "card ask", "aria-label": question },
      h("p", {}, question),
      ...more,
      h(
        "form",
        { method: "dialog", class: "row end" },
        h("button", { value: "no", class: "button", autofocus: true }, no),
        h("button", { value: "yes", class: "button danger" }, yes),
      ),
    );
    dialog.addEventListener("close", () => {
      dialog.remove();
      resolve(dialog.returnValue === "yes");
    });
    document.body.append(dialog);
    dialog.showModal();
  });
}
