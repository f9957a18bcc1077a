/** Buttons for the server's actions, with the status of each request. */

import type { EchoSession, protocol } from "@echoavatar/client";
import { toast } from "./notices.js";

export class ActionPanel {
  private readonly asked = new Map<string, HTMLButtonElement>();
  /** Name of the running action. */
  running = "";

  constructor(private readonly session: EchoSession, private readonly panel: HTMLElement, private readonly list: HTMLElement) {
    session.on("ready", (ready) => this.show(ready.actions));
    session.on("action", (status) => this.take(status));
  }

  private show(names: readonly string[]): void {
    this.panel.hidden = !names.length;
    this.asked.clear();
    this.running = "";
    this.list.replaceChildren(...names.map((name) => this.button(name)));
  }

  private button(name: string): HTMLButtonElement {
    const button = document.createElement("button");
    button.className = "chip";
    button.textContent = spoken(name);
    button.dataset["action"] = name;
    button.onclick = () => this.asked.set(this.session.act(name), button);
    return button;
  }

  private take({ id, name, status, reason }: protocol.ActionStatusMessage): void {
    const button = this.asked.get(id);
    if (!button) return;
    if (status === "started") this.running = spoken(name);
    if (status === "done" || status === "rejected") {
      this.asked.delete(id);
      if (this.running === spoken(name)) this.running = "";
      if (status === "rejected") toast(reason || `“${spoken(name)}” is not possible now.`);
      const others = [...this.asked.values()].includes(button);
      if (!others) delete button.dataset["status"];
      if (status === "done") return;
    }
    button.dataset["status"] = status;
  }
}

/** `raise_left_hand` becomes “Raise left hand”. */
export function spoken(name: string): string {
  const words = name.replace(/[_-]+/g, " ").trim();
  return words.charAt(0).toUpperCase() + words.slice(1);
}
