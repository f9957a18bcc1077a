/** Builds elements in code, without templates, so that user text is never parsed as markup. */

type Child = Node | string | number | null | undefined | false;
type Attribute = string | number | boolean | null | undefined | ((event: Event) => void);

/** Creates an HTML element; `on...` attributes are listeners, `false` and null omit an attribute. */
export function h<Tag extends keyof HTMLElementTagNameMap>(
  tag: Tag,
  attributes: Record<string, Attribute> = {},
  ...children: Child[]
): HTMLElementTagNameMap[Tag] {
  return fill(document.createElement(tag), attributes, children);
}

/** Creates an SVG element. */
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

/** Splits plain text into paragraphs. */
export function paragraphs(text: string): HTMLElement[] {
  return text.split(/\n\s*\n/).map((part) => h("p", {}, part.trim()));
}

/** The element that holds the page's content. */
export const root = (): HTMLElement => document.getElementById("page")!;

/** Replaces the page's content and focuses its heading, so that screen readers announce it. */
export function show(...children: Node[]): void {
  root().replaceChildren(...children);
  const heading = root().querySelector<HTMLElement>("h1[tabindex], h2[tabindex]");
  heading?.focus({ preventScroll: true });
  window.scrollTo(0, 0);
}

/** Announces a text to screen readers. */
export function say(text: string): void {
  const box = document.getElementById("said");
  if (box) box.textContent = text;
}

const NOTE_MS = 5000;

/** Shows a short note and announces it. */
export function note(text: string): void {
  document.querySelector(".note")?.remove();
  const box = h("div", { class: "note" }, text);
  document.body.append(box);
  say(text);
  setTimeout(() => box.remove(), NOTE_MS);
}

/** Asks for confirmation; true when the user agreed. */
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
