/** Writes the form's values as study.yaml. */

export type Value = string | number | boolean | readonly Value[] | { readonly [name: string]: Value };

/** Block YAML; every string is quoted, so none can be parsed as another type. */
export function toYaml(value: Value, indent = ""): string {
  if (Array.isArray(value)) {
    if (!value.length) return "[]\n";
    if (value.every((item) => typeof item !== "object"))
      return `[${value.map((item) => plain(item as string)).join(", ")}]\n`;
    return `\n${(value as readonly Value[]).map((item) => `${indent}- ${toYaml(item, `${indent}  `).replace(/^\n\s*/, "")}`).join("")}`;
  }
  if (typeof value === "object") {
    const lines = Object.entries(value).map(([name, item]) => {
      const text = toYaml(item, `${indent}  `);
      return `${indent}${name}:${text.startsWith("\n") ? "" : " "}${text}`;
    });
    return indent ? `\n${lines.join("")}` : lines.join("");
  }
  return `${plain(value as string | number | boolean)}\n`;
}

function plain(value: string | number | boolean): string {
  return typeof value === "string" ? JSON.stringify(value) : String(value);
}
