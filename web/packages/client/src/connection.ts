/** The connection to the server: sends hello, reconnects with the session's resume key, sends pings. */

import { decodeMessage, encodeMessage } from "./codec.js";
import { Emitter } from "./emitter.js";
import { canDecodeOpus } from "./opus.js";
import {
  type BodyOptions, type ClientMessage, type ErrorMessage as ServerError, type HelloMessage, type ReadyMessage, type ServerMessage, SUBPROTOCOLS, VERSIONS,
} from "./protocol.generated.js";

export type LineState = "connecting" | "open" | "waiting" | "closed";

export interface ConnectionEvents {
  /** `connecting`, `open`, `waiting` (before the next attempt) or `closed` (final). */
  line: LineState;
  message: ServerMessage;
  /** Round-trip time of a ping in milliseconds. */
  roundTrip: number;
}

export interface ConnectionOptions {
  readonly url: string;
  readonly token?: string;
  readonly role?: HelloMessage["role"];
  /** Public name of the session to watch (role `viewer`). */
  readonly session?: string;
  readonly seed?: number;
  /** Keeps a new session's avatar near its place, such as `{ leash_m: 0.5 }` before a camera that does not follow. */
  readonly body?: BodyOptions;
}

const FIRST_WAIT = 0.5;
const LONGEST_WAIT = 8;
const PING_SECONDS = 5;
const FINAL: ReadonlySet<ServerError["code"]> = new Set([
  "unauthorized", "forbidden_origin", "unsupported_version", "replaced",
]);

export class Connection extends Emitter<ConnectionEvents> {
  private socket: WebSocket | null = null;
  private ready: ReadyMessage | null = null;
  private wait = FIRST_WAIT;
  private retry: ReturnType<typeof setTimeout> | undefined;
  private heartbeat: ReturnType<typeof setInterval> | undefined;
  private sentPings = new Map<number, number>();
  private nonce = 0;
  private readonly ticket = [...crypto.getRandomValues(new Uint8Array(12))].join("."); // keeps a place in the queue
  private greeted = false;
  private over = false;

  /** `received` returns the first sample that has not been received and the newest epoch, for a resumed session. */
  constructor(
    private readonly options: ConnectionOptions,
    private readonly received: () => { played: number; epoch: number | null },
  ) {
    super();
  }

  open(): void {
    this.over = false;
    this.emit("line", "connecting");
    const socket = new WebSocket(this.options.url, [SUBPROTOCOLS.msgpack]);
    socket.binaryType = "arraybuffer";
    this.socket = socket;
    this.greeted = false;
    socket.onopen = () => this.greet(socket);
    socket.onmessage = ({ data }) => this.receive(data as ArrayBuffer);
    socket.onclose = () => this.broken(socket);
  }

  close(): void {
    this.over = true;
    clearTimeout(this.retry);
    clearInterval(this.heartbeat);
    this.socket?.close(1000);
    this.emit("line", "closed");
  }

  /** Sends a message; false when there is no connection or no `ready` yet. Nothing is queued here. */
  send(message: ClientMessage): boolean {
    if (!this.greeted || this.socket?.readyState !== WebSocket.OPEN) return false;
    this.socket.send(encodeMessage(message));
    return true;
  }

  /** Bytes in the socket's send buffer. */
  get backlog(): number {
    return this.socket?.bufferedAmount ?? 0;
  }

  private greet(socket: WebSocket): void {
    if (typeof AudioDecoder === "undefined") return socket.send(encodeMessage(this.hello(["pcm"])));
    void canDecodeOpus().then((can) => {
      if (socket.readyState === WebSocket.OPEN) socket.send(encodeMessage(this.hello(can ? ["opus", "pcm"] : ["pcm"])));
    });
  }

  private hello(sound: string[]): HelloMessage {
    const { token = "", role = "source", session = "", seed = 0, body = {} } = this.options;
    return {
      type: "hello", versions: [...VERSIONS], role, token, session, seed, body, sound, ticket: this.ticket,
      audio: { rate: 24000, channels: 1, format: "s16le" },
      resume: this.ready?.resume ?? "",
      ...(this.ready ? this.received() : { played: 0, epoch: null }),
    };
  }

  private receive(data: ArrayBuffer): void {
    const message = decodeMessage(data);
    if (!message) return;
    if (message.type === "ready") this.begin(message);
    else if (message.type === "pong") this.ponged(message.nonce);
    else if (message.type === "error") this.failed(message);
    this.emit("message", message);
  }

  private begin(ready: ReadyMessage): void {
    this.ready = ready;
    this.greeted = true;
    this.wait = FIRST_WAIT;
    clearInterval(this.heartbeat);
    const seconds = Math.min(PING_SECONDS, ready.limits.ping_seconds / 2);
    this.heartbeat = setInterval(() => this.ping(), seconds * 1000);
    this.emit("line", "open");
    this.ping();
  }

  private failed(error: ServerError): void {
    if (error.code === "unknown_session") this.ready = null; // too late to resume: start a new session
    if (error.retry_after) this.wait = error.retry_after;
    if (error.fatal && FINAL.has(error.code)) this.close();
  }

  private broken(socket: WebSocket): void {
    if (socket !== this.socket || this.over) return;
    this.greeted = false;
    clearInterval(this.heartbeat);
    this.emit("line", "waiting");
    this.retry = setTimeout(() => this.open(), this.wait * 1000);
    this.wait = Math.min(LONGEST_WAIT, this.wait * 2);
  }

  private ping(): void {
    this.sentPings.set(++this.nonce, performance.now());
    this.send({ type: "ping", nonce: this.nonce });
  }

  private ponged(nonce: number): void {
    const sent = this.sentPings.get(nonce);
    if (sent === undefined) return;
    this.sentPings.clear();
    this.emit("roundTrip", performance.now() - sent);
  }
}
