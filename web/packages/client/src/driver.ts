/** What shows poses: a body of some make, bound once to the rig and the face names of a session. */

import type { Pose } from "./pose.js";
import type { ReadyMessage } from "./protocol.generated.js";

export interface AvatarDriver {
  /** Matches joints and face curves by name; called once for each session. */
  bind(ready: Pick<ReadyMessage, "rig" | "face">): void;
  /** Takes the pose. */
  apply(pose: Pose): void;
  /** Lets hair and cloth follow; `seconds` since the last picture. */
  update(seconds: number): void;
  dispose(): void;
}
