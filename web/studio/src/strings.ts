/**
 * What the pages say. All English words are in `words/en.json`; `{name}` is filled in. A study's `language` chooses the
 * words of its raters' page: a file with the same keys that the studio serves. What it lacks is said in English.
 */

import en from "./words/en.json";

export type Key = keyof typeof en;
export type Words = Partial<Record<Key, string>>;
let chosen: Words = en;

/**
 * Speaks a language, such as de-AT: its own words, else those of de, else English. `fetch` gives a language's words,
 * null where there are none.
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

/** What to say. */
export function t(key: Key, values: Record<string, string | number> = {}): string {
  return (chosen[key] || en[key]).replace(/\{(\w+)\}/g, (whole, name: string) => String(values[name] ?? whole));
}

/** The word of a code that came from the studio: `t` for keys that are put together. */
export function word(prefix: string, code: string): string {
  const key = `${prefix}_${code}`;
  return key in en ? t(key as Key) : code;
}
