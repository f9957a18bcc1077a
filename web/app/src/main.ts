/** The live page: the avatar, its sound sources and its controls. */

import { EchoSession } from "@echoavatar/client";
import { DetailControl, isSoftware } from "@echoavatar/client/three";
import playbackWorklet from "@echoavatar/client/worklets/playback?worker&url";
import { ActionPanel } from "./actions.js";
import { AvatarSlot } from "./avatars.js";
import { connectDrop } from "./dropzone.js";
import { Hud } from "./hud.js";
import { drawIcons } from "./icons.js";
import { MannerPanel } from "./manner.js";
import { SourceBar } from "./sourcebar.js";
import { Viewport } from "./viewport.js";
import { StatusLine } from "./statusline.js";
import { Tools } from "./tools.js";
import { Wardrobe } from "./wardrobe.js";

const element = <Kind extends HTMLElement>(id: string) => document.getElementById(id) as Kind;
const settings = new URLSearchParams(location.search);

/** Reads the token from `?token=...` or `#token=...`, removes it from the address bar and keeps it for this tab. */
function takeToken(): string {
  const token = settings.get("token") ?? new URLSearchParams(location.hash.slice(1)).get("token");
  if (token === null) return sessionStorage.getItem("token") ?? "";
  sessionStorage.setItem("token", token);
  settings.delete("token");
  history.replaceState(null, "", location.pathname + (settings.size ? `?${settings}` : ""));
  return token;
}

/** `?watch=NAME` shows another program's session without sound; `?watch` alone shows the newest session. */
async function watched(token: string): Promise<string> {
  const name = settings.get("watch");
  return name === "" ? ((await listed(token)).at(-1) ?? "") : (name ?? "");
}

/** The sessions of this server, the newest last; none if it does not say. */
async function listed(token: string): Promise<readonly string[]> {
  const answer = await fetch("./v1/sessions", { headers: token ? { authorization: `Bearer ${token}` } : {} }).catch(() => null);
  if (!answer?.ok) return [];
  const { sessions = [] } = (await answer.json()) as { sessions?: string[] };
  return sessions;
}

async function start(): Promise<void> {
  drawIcons();
  const quality = settings.get("quality");
  const isSlow = isSoftware();
  const low = quality === "low" || (quality !== "high" && isSlow);
  document.documentElement.dataset["quality"] = low ? "low" : "high";
  const background = settings.get("background") ?? "";
  const viewport = new Viewport(element<HTMLCanvasElement>("view"), low, background === "clear");
  document.documentElement.dataset["background"] = background;
  const token = takeToken();
  const leader = await watched(token);
  if (settings.has("watch")) document.documentElement.dataset["watch"] = "";
  const session = new EchoSession({
    role: settings.has("watch") ? "viewer" : "source",
    session: leader,
    url: new URL("v1/stream", location.href).href.replace(/^http/, "ws").replace(/[?#].*$/, ""),
    token,
    playbackWorklet,
  });
  const avatar = new AvatarSlot(viewport);
  const hud = new Hud(element("hud"), session);
  const actions = new ActionPanel(session, element("actions"), element("action-list"));
  new MannerPanel(session, element("manner"), element("gestures"));
  const sources = new SourceBar(session, token);
  const states = new StatusLine(session, actions, sources);
  const detail = new DetailControl(isSlow || quality === "low");
  const wardrobe = new Wardrobe(viewport, avatar, detail, async () => (await listed(token)).filter((name) => leader || name !== session.ready?.session));
  const tools = new Tools(viewport, session, avatar, wardrobe, () => sources.output, settings);
  connectDrop(wardrobe, sources);
  session.on("ready", (ready) => avatar.bind(ready));
  void wardrobe.show(settings.get("character") ?? "", settings.get("outfit") ?? "");
  session.connect();
  run(viewport, session, avatar, { hud, states, sources, detail });
  Object.assign(window, { __echo: inspect(session, viewport, avatar, hud, sources, tools, detail) });
}

const EMPTY_MS = 400; // between pictures of the empty stage, which may be drawn by the processor that reads the avatar
const EMPTY_S = 10; // as if so long had passed: an empty stage is at once where it belongs, and tells nothing of the machine's speed

interface Shown {
  readonly hud: Hud;
  readonly states: StatusLine;
  readonly sources: SourceBar;
  readonly detail: DetailControl;
}

/** The render loop; a hidden tab draws nothing and catches up when it is shown again. */
function run(viewport: Viewport, session: EchoSession, avatar: AvatarSlot, { hud, states, sources, detail }: Shown): void {
  let last = performance.now();
  let drawn = -Infinity;
  const silhouette = element("silhouette");
  const draw = (now: number) => {
    requestAnimationFrame(draw);
    const seconds = Math.max(0, (now - last) / 1000);
    if (!viewport.isDue(seconds)) return;
    last = now;
    const picture = session.picture(performance.now());
    inspected.shown = picture && { at: picture.at, held: picture.held, state: picture.state };
    if (avatar.driver) {
      avatar.present(picture, seconds);
      silhouette.classList.add("gone");
    } else viewport.shadow(silhouette);
    avatar.follow(seconds);
    viewport.echoes.advance(sources.output?.level ?? 0, seconds);
    states.show(picture);
    if (picture) viewport.suit(picture.state, seconds);
    if (picture?.state !== "dancing") viewport.settle(seconds);
    viewport.isCheapest = !avatar.ours || detail.isCheapest;
    if (avatar.driver || now - drawn > EMPTY_MS) {
      viewport.render(avatar.driver ? seconds : EMPTY_S);
      drawn = now;
    }
    if (avatar.ours && detail.picture(seconds)) void avatar.show(avatar.ours, detail.level).catch(() => detail.restart());
    hud.picture();
  };
  requestAnimationFrame(draw);
}

/** The pose on screen, for `inspect`. */
const inspected: { shown: { at: number; held: boolean; state: string } | null } = { shown: null };

/** What tests and the browser console can read. */
function inspect(session: EchoSession, viewport: Viewport, avatar: AvatarSlot, hud: Hud, sources: SourceBar, tools: Tools, detail: DetailControl) {
  return {
    session, viewport, avatar, sources, tools, detail,
    get shown() {
      return inspected.shown;
    },
    get metrics() {
      const { player } = session;
      return player && { ...player.played, ahead: player.ahead, playing: player.playing, reaction: session.reaction, ...hud.summary };
    },
    get sync() {
      return session.player?.sync.summary() ?? null;
    },
    resetSync: () => session.player?.sync.reset(),
  };
}

void start();
