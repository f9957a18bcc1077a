/** The words under the avatar, and the state of the line: both follow what is heard, not what has arrived. */

import type { EchoSession, LineState, Picture, protocol } from "@echoavatar/client";
import type { ActionPanel } from "./actions.js";
import { subtitle, toast } from "./notices.js";
import type { SourceBar } from "./sourcebar.js";

const LINES: Record<LineState, string> = {
  connecting: "connecting", open: "", waiting: "the line broke, trying again", closed: "disconnected",
};

export class StateLine {
  private text = "";
  private busyAt = -Infinity; // when the avatar was last speaking or dancing

  constructor(session: EchoSession, private readonly actions: ActionPanel, private readonly sources: SourceBar) {
    const line = document.getElementById("line")!;
    session.on("line", (state) => (line.textContent = LINES[state]));
    session.on("error", (error) => toast(sentence(error)));
  }

  /** Once a picture. */
  show(picture: Picture | null): void {
    if (!picture) return;
    const { state } = picture;
    const busy = state === "speaking" || state === "dancing";
    if (busy) this.busyAt = picture.at;
    this.sources.busy = Math.abs(picture.at - this.busyAt) < 36_000; // the clock of a new session begins at 0
    const text = this.words(state);
    if (text !== this.text) subtitle(text);
    this.text = text;
  }

  private words(state: protocol.MotionMessage["state"]): string {
    const { title } = this.sources;
    if (this.actions.running) return this.actions.running;
    if (state === "speaking") return "Speaking";
    if (state === "dancing") return title && title !== "avatar" ? `Dancing to “${title}”` : "Dancing";
    if (state === "listening") return "Listening to you";
    return "";
  }
}

function sentence({ code, message, retry_after: seconds }: protocol.ErrorMessage): string {
  if (code === "overloaded") return `All places are taken. Trying again in ${Math.ceil(seconds)} s.`;
  if (code === "unauthorized") return "This server asks for a token: open the address that it printed.";
  if (code === "unknown_session") return "The session had ended; a new one begins.";
  return message.charAt(0).toUpperCase() + message.slice(1);
}
