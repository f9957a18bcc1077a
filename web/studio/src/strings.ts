/**
 * The pages' texts. English is in `words/en.json`; `{name}` is a placeholder. A study's `language` selects another file
 * with the same keys, served by the studio. Missing keys fall back to English.
 */

import en from "./words/en.json";

export type Key = keyof typeof en;
export type Words = Partial<Record<Key, string>>;
let chosen: Words = en;

/**
 * Selects a language: for de-AT its own texts, else those of de, else English. `fetch` returns a language's texts, or
 * null.
 */
export async function speak(language: string, fetch: (code: string) => Promise<Words | null>): Promise<void> {
  let [known, words]: [string, Words] = ["en", en];
  for (const code of new Set([language, language.split("-")[0]!])) {
    const found = code === "en" ? en : await fetch(code);
    if (!found) continue;
    [known, words] = [code, found];
    break;
  }
  chosen = words;
  document.documentElement.lang = known;
}

/** The text of a key. */
export function t(key: Key, values: Record<string, string | number> = {}): string {
  return (chosen[key] || en[key]).replace(/\{(\w+)\}/g, (whole, name: string) => String(values[name] ?? whole));
}

/** The text of a code from the studio: `t` for composed keys. */
export function word(prefix: string, code: string): string {
  const key = `${prefix}_${code}`;
  return key in en ? t(key as Key) : code;
}
