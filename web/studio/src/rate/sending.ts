/** Sends an answer until the studio says that it is saved, or that it will not be. */

import { type Api, Refused } from "../api.js";
import type { Saved } from "../api.generated.js";
import { type Insisting, insist } from "../patience.js";
import { type Draft, dropDraft } from "./draft.js";

/** What became of an answer: only `saved` was said by the studio to be on disk. */
export type Outcome =
  | { readonly kind: "saved"; readonly saved: Saved }
  /** Another tab or device was first, or the task is no longer this rater's. */
  | { readonly kind: "elsewhere" }
  /** The session has changed: ask `me` again, then send again. */
  | { readonly kind: "session" }
  | { readonly kind: "refused"; readonly refused: Refused };

/** The same draft sends the same bytes under the same key, however often. */
export async function send(api: Api, draft: Draft, insisting: Insisting = {}): Promise<Outcome> {
  const path = `/api/rater/tasks/${encodeURIComponent(draft.task)}/answer`;
  try {
    const saved = await insist(() => api.post<Saved>(path, draft.sent, { "idempotency-key": draft.key }), insisting);
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
