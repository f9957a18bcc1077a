/** Who is shown: the built-in characters, and the files that the visitor dropped in this visit. */

import type { DetailControl } from "@echoavatar/client/three";
import type { AvatarSlot } from "./avatars.js";
import { spoken } from "./actions.js";
import { type Choice, toast } from "./notices.js";
import type { Viewport } from "./viewport.js";

interface Own {
  readonly name: string;
  readonly data: ArrayBuffer;
  readonly files: ReadonlyMap<string, Blob>;
  readonly picture: string;
}

const MOST = 6; // dropped avatars that are kept, the newest first
const PATIENCE_MS = 300; // of a visitor who opens the menu
const TOLD = 6; // curves that a notice names

export class Wardrobe {
  private readonly names: readonly string[];
  private own: Own[] = [];
  private worn = "";
  private others: readonly string[] = []; // sessions that can be watched

  constructor(private readonly viewport: Viewport, private readonly avatar: AvatarSlot, private readonly detail: DetailControl, private readonly sessions: () => Promise<readonly string[]>) {
    const told = document.querySelector<HTMLMetaElement>("meta[name=characters]")?.content ?? "";
    this.names = told.split(" ").filter(Boolean);
  }

  /** Asks which other programs' sessions can be watched; a slow answer counts the next time. */
  look(): Promise<void> {
    const told = this.sessions().then((sessions) => void (this.others = sessions));
    return Promise.race([told, new Promise<void>((resolve) => setTimeout(resolve, PATIENCE_MS))]);
  }

  /** What the menu offers. */
  get choices(): Choice[] {
    const ours = this.names.map((name) => ({
      id: name, label: spoken(name), picture: `./faces/${name}.webp`, on: this.worn === name, run: () => void this.show(name),
    }));
    const own = this.own.map((one) => ({
      id: one.name, label: one.name, picture: one.picture, on: this.worn === one.name, run: () => void this.wear(one.name, one.data, one.files).catch((error: Error) => toast(error.message)),
    }));
    const open = { id: "open", label: "Your own", hint: "A .vrm or .glb file, dropped or chosen", run: () => document.getElementById("file")!.click() };
    return [...ours, ...own, open, ...this.outfits, ...this.watching];
  }

  /** What the shown avatar can wear, each with a picture of it. */
  private get outfits(): Choice[] {
    const { avatar, viewport } = this;
    const { names = [] } = avatar.driver?.outfits ?? {};
    const worn = avatar.outfit;
    const rows = names.map((label, outfit) => {
      avatar.wear(outfit);
      const picture = viewport.portrait(null);
      const run = () => {
        avatar.wear(outfit);
        if (avatar.ours) remember("outfit", label);
      };
      return { id: `outfit-${outfit}`, label, picture, on: outfit === worn, run, ...(outfit ? {} : { under: "Outfit" }) };
    });
    avatar.wear(worn);
    return rows;
  }

  /** Other programs' sessions, and the way back to one's own. */
  private get watching(): Choice[] {
    const watched = new URLSearchParams(location.search).get("watch");
    const to = (name: string | null) => () => {
      remember("watch", name);
      location.reload();
    };
    const rows: Choice[] = this.others.map((name) => ({ id: `watch-${name}`, label: name, hint: "Another program's session", on: name === watched, run: to(name) }));
    if (watched !== null) rows.push({ id: "watch", label: "Your own session", run: to(null) });
    return rows.map((row, number) => (number ? row : { ...row, under: "Watch" }));
  }

  /** Shows a built-in character, the first if there is none of that name, in an outfit if it has that. */
  async show(wished: string, outfit = ""): Promise<void> {
    const name = this.names.includes(wished) ? wished : this.names[0] ?? "";
    try {
      await this.avatar.show(name === this.names[0] ? "./avatar.glb" : `./avatar.glb?character=${name}`, this.detail.level);
      this.detail.restart();
      this.worn = name;
      const wish = this.avatar.driver?.outfits.names.indexOf(outfit) ?? -1;
      if (wish >= 0) this.avatar.wear(wish);
      remember("character", name === this.names[0] ? "" : name);
      remember("outfit", wish < 0 ? "" : outfit);
    } catch (error) {
      toast(`The avatar could not be shown: ${(error as Error).message}. Drop a .vrm or .glb file here instead.`);
    }
  }

  /** Shows an avatar from a file; throws an error that names the file. */
  async wear(name: string, data: ArrayBuffer, files: ReadonlyMap<string, Blob>): Promise<void> {
    try {
      await this.avatar.load(data.slice(0), files);
    } catch (error) {
      throw new Error(`“${name}” could not be worn: ${(error as Error).message}`);
    }
    this.worn = name;
    this.own = [{ name, data, files, picture: this.viewport.portrait(this.avatar.head) }, ...this.own.filter((other) => other.name !== name)].slice(0, MOST);
    const still = this.avatar.driver?.silent ?? [];
    const more = still.length - TOLD;
    if (still.length) toast(`Nothing on the face of “${name}” shows ${still.slice(0, TOLD).join(", ")}${more > 0 ? ` and ${more} more` : ""}.`);
  }
}

/** Keeps a choice in the page's address; an empty value is the page's own choice. */
export function remember(name: string, value: string | null): void {
  const address = new URL(location.href);
  if (value) address.searchParams.set(name, value);
  else address.searchParams.delete(name);
  history.replaceState(null, "", address);
}
