/** The overlay with latency and sync figures. */

import type { EchoSession, protocol } from "@echoavatar/client";

const POINTS = 120;

export class Hud {
  private readonly values = new Map<string, HTMLElement>();
  private readonly canvas = document.createElement("canvas");
  private readonly trace: number[] = [];
  private stats: protocol.StatsMessage | null = null;
  private roundTrip = NaN;
  private readonly drawn: number[] = []; // when pictures were drawn in the last second

  constructor(private readonly box: HTMLElement, private readonly session: EchoSession) {
    const rows = ["Sync, mean", "Sync, 99 %", "First reaction", "Buffered ahead", "Network, there and back", "Model step", "Model load", "Pictures per second", "Waits for data"];
    const list = document.createElement("dl");
    for (const row of rows) {
      const value = document.createElement("dd");
      list.append(Object.assign(document.createElement("dt"), { textContent: row }), value);
      this.values.set(row, value);
    }
    const title = Object.assign(document.createElement("p"), { textContent: "Pose against sound, ± 60 ms" });
    this.canvas.setAttribute("aria-hidden", "true");
    box.append(title, this.canvas, list);
    session.on("stats", (stats) => (this.stats = stats));
    session.on("roundTrip", (milliseconds) => (this.roundTrip = milliseconds));
    setInterval(() => !box.hidden && this.write(), 500);
  }

  /** Call after each picture that was drawn. */
  picture(): void {
    const now = performance.now();
    this.drawn.push(now);
    while (this.drawn[0]! < now - 1000) this.drawn.shift();
    const { player } = this.session;
    if (!player || this.box.hidden) return;
    this.trace.push(player.sync.last);
    if (this.trace.length > POINTS) this.trace.shift();
    this.draw();
  }

  get summary() {
    return { fps: this.drawn.length, roundTrip: this.roundTrip, stats: this.stats };
  }

  private write(): void {
    const { player } = this.session;
    if (!player) return;
    const sync = player.sync.summary();
    const set = (row: string, text: string) => (this.values.get(row)!.textContent = text);
    const ms = (value: number) => (Number.isFinite(value) ? `${value.toFixed(value < 9.95 ? 1 : 0)} ms` : "–");
    set("Sync, mean", ms(sync.mean_abs_ms));
    set("Sync, 99 %", ms(sync.p99_ms));
    set("First reaction", ms(this.session.reaction));
    set("Buffered ahead", ms(player.ahead * 1000));
    set("Network, there and back", ms(this.roundTrip));
    set("Model step", ms(this.stats?.step_ms ?? NaN));
    set("Model load", this.stats ? `${(this.stats.rtf * 100).toFixed(0)} %` : "–");
    set("Pictures per second", String(this.drawn.length));
    set("Waits for data", String(player.played.underruns));
  }

  private draw(): void {
    const { canvas } = this;
    const scale = devicePixelRatio;
    const [width, height] = [canvas.clientWidth * scale, canvas.clientHeight * scale];
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    const brush = canvas.getContext("2d")!;
    const style = getComputedStyle(canvas);
    brush.clearRect(0, 0, width, height);
    brush.strokeStyle = style.getPropertyValue("--line");
    brush.lineWidth = scale;
    brush.strokeRect(0, height / 2, width, 0.01);
    brush.strokeStyle = style.getPropertyValue("--accent");
    brush.lineWidth = 1.5 * scale;
    brush.beginPath();
    this.trace.forEach((error, i) => {
      const y = height / 2 - (Math.max(-60, Math.min(60, error)) / 60) * (height / 2 - 2);
      brush.lineTo((i / (POINTS - 1)) * width, y);
    });
    brush.stroke();
  }
}
