/** Keyboard shortcuts of the page; fields, buttons and dialogs keep their keys. */

const NATIVE = "button, a, summary, input, select, textarea";

/** `handle` returns whether it used the key. Returns a function that removes the listener. */
export function onKeys(handle: (key: string) => boolean): () => void {
  const listen = (event: KeyboardEvent) => {
    const target = event.target as Element;
    if (event.ctrlKey || event.metaKey || event.altKey || event.repeat || document.querySelector("dialog[open]"))
      return;
    if (!isOurs(event.key, target)) return;
    if (handle(event.key.length === 1 ? event.key.toLowerCase() : event.key)) event.preventDefault();
  };
  document.addEventListener("keydown", listen);
  return () => document.removeEventListener("keydown", listen);
}

function isOurs(key: string, target: Element): boolean {
  const field = target.closest?.(NATIVE);
  if (!field) return true;
  if (field.matches("textarea, select, input:not([type=radio])")) return false;
  if (key === " " || key === "Enter") return field.matches("input[type=radio]") && key === "Enter";
  return !(key.startsWith("Arrow") && field.matches("input[type=radio]"));
}
