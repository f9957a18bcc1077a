/** Turns errors into messages. */

import { Refused, Unreachable } from "./api.js";
import { type Key, t } from "./strings.js";

export function explain(error: unknown): string {
  if (error instanceof Refused) return t(`problem_${error.code}` as Key, { message: error.message });
  if (error instanceof Unreachable) return t("problem_unreachable");
  return t("problem_unknown", { message: error instanceof Error ? error.message : String(error) });
}
