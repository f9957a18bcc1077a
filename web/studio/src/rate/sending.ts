/** Sends an answer until the studio confirms or rejects it. */

import { type Api, Refused } from "../api.js";
import type { Saved } from "../api.generated.js";
import { type RetryOptions, retry } from "../retry.js";
import { type Draft, dropDraft } from "./draft.js";

/** The outcome of sending; `saved` means that the studio has it on disk. */
export type Outcome =
  | { readonly kind: "saved"; readonly saved: Saved }
  /** Another tab or device was first, or the task no longer belongs to this rater. */
  | { readonly kind: "elsewhere" }
  /** The session has changed: call `me`, then send again. */
  | { readonly kind: "session" }
  | { readonly kind: "refused"; readonly refused: Refused };

/** Repeated calls send the same bytes with the same key. */
export async function send(api: Api, draft: Draft, insisting: RetryOptions = {}): Promise<Outcome> {
  const path = `/api/rater/tasks/${encodeURIComponent(draft.task)}/answer`;
  try {
    const saved = await retry(() => api.post<Saved>(path, draft.sent, { "idempotency-key": draft.key }), insisting);
    dropDraft(draft.task);
    return { kind: "saved", saved };
  } catch (error) {
    if (!(error instanceof Refused)) throw error;
    switch (error.code) {
      case "already_judged":
      case "key_reused":
      case "not_found":
        dropDraft(draft.task);
        return { kind: "elsewhere" };
      case "bad_csrf":
      case "not_signed_in":
      case "needs_consent":
        return { kind: "session" };
      default:
        return { kind: "refused", refused: error };
    }
  }
}
