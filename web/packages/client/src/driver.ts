/** Applies poses to an avatar. A driver is bound once to a session's rig and face curve names. */

import type { Pose } from "./pose.js";
import type { ReadyMessage } from "./protocol.generated.js";

export interface AvatarDriver {
  /** Matches joints and face curves by name; called once per session. */
  bind(ready: Pick<ReadyMessage, "rig" | "face">): void;
  /** Applies a pose. */
  apply(pose: Pose): void;
  /** Advances hair and cloth simulation; `seconds` since the previous display frame. */
  update(seconds: number): void;
  dispose(): void;
}
