/** The subtitle and the connection status. Both follow what is heard, not what has arrived. */

import type { EchoSession, LineState, Picture, protocol } from "@echoavatar/client";
import type { ActionPanel } from "./actions.js";
import { subtitle, toast } from "./notices.js";
import type { SourceBar } from "./sourcebar.js";

const LINES: Record<LineState, string> = {
  connecting: "connecting", open: "", waiting: "the line broke, trying again", closed: "disconnected",
};

export class StatusLine {
  private text = "";
  private busyAt = -Infinity; // sample at which there was last something to interrupt
  private isBusy = false;
  private waiting = ""; // what is said instead while the server is full
  private isOpen = false; // the line
  private at = NaN; // sample of the last picture
  private last: protocol.MotionMessage["state"] = "speaking";

  constructor(session: EchoSession, private readonly actions: ActionPanel, private readonly sources: SourceBar) {
    const line = document.getElementById("line")!;
    session.on("line", (state) => {
      this.isOpen = state === "open";
      line.textContent = this.waiting ? "" : LINES[state];
    });
    session.on("error", (error) => {
      if (error.code === "unauthorized") return askToken();
      this.waiting = error.place ? `All places are taken. ${error.place === 1 ? "You are next" : `You are number ${error.place} in the queue`}.` : "";
      if (!this.waiting) toast(sentence(error));
    });
    session.on("ready", () => (this.waiting = ""));
  }

  /** Call once per display frame. */
  show(picture: Picture | null): void {
    const isOver = !this.isOpen && picture?.at === this.at; // all that had come before the line broke was shown
    this.at = picture?.at ?? NaN;
    if (!picture || this.waiting || isOver) return this.say(this.waiting);
    const { state } = picture;
    const speaking = this.sources.isSpeaking(picture);
    const acting = state === "acting" && this.isBusy; // sound may go on under an action
    if (state === "speaking" || state === "dancing" || speaking || acting) this.busyAt = picture.at;
    this.isBusy = Math.abs(picture.at - this.busyAt) < 36_000; // a new session's clock starts at 0
    this.sources.busy = this.isBusy;
    if (state === "speaking" || state === "dancing") this.last = state;
    this.say(this.words(speaking && (state === "idle" || state === "acting") ? this.last : state)); // through pauses
  }

  private say(text: string): void {
    if (text !== this.text) subtitle(text);
    this.text = text;
  }

  private words(state: protocol.MotionMessage["state"]): string {
    const { title } = this.sources;
    if (this.actions.running) return this.actions.running;
    if (state === "speaking") return "Speaking";
    if (state === "dancing") return title ? `Dancing to “${title}”` : "Dancing";
    if (state === "listening") return "Listening to you";
    return "";
  }
}

/** Asks for the server's token, and begins again with it. */
function askToken(): void {
  const gate = document.getElementById("gate") as HTMLDialogElement;
  if (gate.open) return;
  gate.showModal();
  gate.querySelector("form")!.onsubmit = () => {
    sessionStorage.setItem("token", gate.querySelector("input")!.value.trim());
    location.reload();
  };
}

function sentence({ code, message, retry_after: seconds }: protocol.ErrorMessage): string {
  if (code === "overloaded") return `All places are taken. Trying again in ${Math.ceil(seconds)} s.`;
  if (code === "unknown_session") return "The session had ended; a new one begins.";
  return message.charAt(0).toUpperCase() + message.slice(1);
}
