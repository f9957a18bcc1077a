// Made from src/echoavatar/wire/messages.py by scripts/make_protocol.py; do not edit.

export const VERSIONS = [1] as const;
export const SUBPROTOCOLS = {
  "msgpack": "echoavatar.v1.msgpack",
  "json": "echoavatar.v1.json"
} as const;
export const MAX_MESSAGE_BYTES = 8388608;
export const SAMPLE_RATE = 24000;
export const FRAME_RATE = 30;
export const SAMPLES_PER_FRAME = 800;
export const CLOSE_CODES = {
  "bad_message": 4400,
  "bad_order": 4400,
  "bad_audio": 4400,
  "unauthorized": 4401,
  "forbidden_origin": 4403,
  "unknown_session": 4404,
  "timeout": 4408,
  "replaced": 4409,
  "too_large": 1009,
  "unsupported_version": 4426,
  "overloaded": 4429,
  "inbox_full": 4429,
  "too_slow": 4430,
  "internal": 1011,
  "shutting_down": 1012
} as const;

/** Perform one of `ready.actions`; answered by `action_status` with the same id. */
export interface ActionMessage {
  type: "action";
  id: string;
  name: string;
  /** size of its movements; 1: as in its clip */
  intensity?: number;
  hold?: number | null;
}

/** The status of an `action` or `music` message. */
export interface ActionStatusMessage {
  type: "action_status";
  id: string;
  name: string;
  status: "accepted" | "done" | "rejected" | "started";
  /** a sample index or a count of samples */
  at: number;
  reason: string;
  /** rejected names: what there is instead */
  choices: string[];
}

/** Sound of one utterance, in order, as fast as the source likes (the inbox is bounded: `ready.limits`). */
export interface AudioMessage {
  type: "audio";
  /** number of an utterance, growing, counted per speaker */
  seg: number;
  /** samples (per channel, source rate) of `seg` sent before these */
  start: number;
  pcm: Uint8Array;
  /** user: the avatar listens to it; it is not played */
  speaker?: "avatar" | "user";
}

/** Format of the bytes in `audio` messages; two channels are interleaved. */
export interface AudioFormat {
  /** samples per second */
  rate?: number;
  channels?: number;
  format?: "f32le" | "s16le";
}

/** How the body moves. A camera that stands still loses a dancer who is free to walk. */
export interface BodyOptions {
  /** metres the hips may be from where they started; 0: no leash */
  leash_m?: number;
  /** hips stay over the start */
  in_place?: boolean;
  /** hips and legs stand idle, everything above moves */
  upper_body?: boolean;
  /** 0: hardly a gesture, 1: a storyteller; absent: by seed */
  liveliness?: number | null;
  /** hand of one-handed gestures, 0: left; absent: by seed */
  handedness?: number | null;
  /** share of the time in which the eyes meet the viewer while the avatar speaks */
  eye_contact?: number;
  /** how far the face shows what the voice feels, 0: not at all */
  feeling?: number;
}

/** The utterance is complete; silence follows until the next one. */
export interface EndMessage {
  type: "end";
  /** number of an utterance, growing, counted per speaker */
  seg: number;
  speaker?: "avatar" | "user";
}

/** What went wrong. After a `fatal` error the connection is closed with the code's number in `CLOSE_CODES`. */
export interface ErrorMessage {
  type: "error";
  code: "bad_audio" | "bad_message" | "bad_order" | "forbidden_origin" | "inbox_full" | "internal" | "overloaded" | "replaced" | "shutting_down" | "timeout" | "too_large" | "too_slow" | "unauthorized" | "unknown_session" | "unsupported_version";
  message: string;
  fatal: boolean;
  /** seconds; 0: trying again will not help */
  retry_after: number;
  /** overloaded: place in the queue of tickets, from 1 on; 0: none */
  place: number;
}

/** Motion and audio from `at` on are void: drop them, and hold the pose at `at` until new motion arrives. */
export interface FlushMessage {
  type: "flush";
  /** a sample index or a count of samples */
  at: number;
  /** epoch of all that follows; messages of older epochs are stale */
  epoch: number;
  /** the utterance cut off; 0 is none */
  seg: number;
  /** samples of `seg` heard, at 24 kHz */
  heard: number;
}

/** The first message, sent once. A source sends sound; a viewer joins a running session and watches. */
export interface HelloMessage {
  type: "hello";
  versions?: number[];
  role?: "source" | "viewer";
  token?: string;
  audio?: AudioFormat;
  /** streams to be sent */
  want?: ("audio" | "motion")[];
  /** how sound may be sent: pcm, opus; unknown names are ignored */
  sound?: string[];
  /** viewer: the session to watch */
  session?: string;
  /** the key of `ready`, to resume after the connection broke */
  resume?: string;
  /** resuming: everything before it was received; the rest is sent again */
  played?: number;
  /** resuming: the newest one received; a `flush` missed since is sent again */
  epoch?: number | null;
  /** any text that no other client has; repeating it soon keeps the place in the queue */
  ticket?: string;
  /** equal seed and sound give equal motion */
  seed?: number;
  /** for a new session; a resumed one keeps its own */
  body?: BodyOptions;
}

/** Stop at once: discard all sound from `heard` on, and utterances up to `seg`, as if they had never been sent. */
export interface InterruptMessage {
  type: "interrupt";
  /** clock: first sample not heard; absent: that of the last `played` */
  heard?: number | null;
  /** 0: the newest utterance known */
  seg?: number;
}

/** Milliseconds from the arrival of a sample to the departure of its motion. */
export interface Latency {
  /** waiting for a whole chunk */
  algorithm: number;
  /** one step, as measured */
  compute: number;
}

/** How much the server holds, and for how long. */
export interface Limits {
  message_bytes: number;
  /** sound that may wait to become motion */
  inbox_seconds: number;
  /** motion is never sent further ahead of playback */
  ahead_seconds: number;
  /** how long a session waits for its source to return */
  resume_seconds: number;
  /** the client sends something at least this often */
  ping_seconds: number;
}

/** How the speaker gestures from the next chunk on; what is absent stays as it is. See `ready.manner`. */
export interface MannerMessage {
  type: "manner";
  /** 0: hardly a gesture, 1: a storyteller */
  liveliness?: number | null;
  /** hand of one-handed gestures, 0: left, 1: right */
  handedness?: number | null;
}

/** Consecutive frames of body and face, 800 samples each; see `blobs` for the bytes. */
export interface MotionMessage {
  type: "motion";
  /** clock of the first frame */
  at: number;
  epoch: number;
  frames: number;
  /** i16le [frames][joints][x y z w] / 32767, parent-relative */
  rotations: Uint8Array;
  /** f32le [frames][x y z] metres, of the hips */
  root: Uint8Array;
  /** u8 [frames][names] / 255; empty without a face */
  face: Uint8Array;
  state: "acting" | "dancing" | "idle" | "listening" | "speaking";
}

/** Play one of `ready.tracks` (the first if there is no title), or stop; answered by `action_status`. */
export interface MusicMessage {
  type: "music";
  id: string;
  op: "play" | "stop";
  title?: string;
}

/** The sound of `audio` as Opus, for clients whose `hello.sound` has it. It lags motion by less than 27 ms. */
export interface PackedSoundMessage {
  type: "opus";
  /** clock of the first sample decoded, after `skip` */
  at: number;
  epoch: number;
  /** utterance that speaks here; 0 is none */
  seg: number;
  /** samples to drop first, at 24 kHz; above 0: begin with a new decoder */
  skip: number;
  /** 20 ms each, mono */
  packets: Uint8Array[];
}

/** Answered at once by `pong` with the same number. */
export interface PingMessage {
  type: "ping";
  nonce?: number;
}

/** The playback position, five times a second. Motion goes at most `limits.ahead_seconds` beyond the source's. */
export interface PlayedMessage {
  type: "played";
  /** clock: first sample not yet heard */
  at: number;
  /** epoch of the newest `flush` or `ready` processed */
  epoch?: number;
  /** gaps in playback so far */
  underruns?: number;
}

/** The answer to `ping`. */
export interface PongMessage {
  type: "pong";
  nonce: number;
  /** a sample index or a count of samples */
  at: number;
}

/** The answer to `hello`: everything that stays constant, once. */
export interface ReadyMessage {
  type: "ready";
  version: number;
  server: string;
  /** its public name, for viewers */
  session: string;
  /** its key, for the source alone; empty for viewers */
  resume: string;
  resumed: boolean;
  /** clock of the next motion */
  at: number;
  epoch: number;
  /** resumed: newest utterance known */
  seg: number;
  /** resumed: samples of `seg` received, source rate */
  received: number;
  sample_rate: number;
  frame_rate: number;
  chunk_samples: number;
  rig: Rig;
  /** ARKit names, in order; empty without a face */
  face: string[];
  actions: string[];
  tracks: string[];
  /** fields of `manner` that this model follows */
  manner: string[];
  latency: Latency;
  limits: Limits;
  /** opus: most sound comes as `opus` messages, not `audio` */
  sound: "opus" | "pcm";
}

/** The skeleton: metres, Y up, facing +Z, left at +X; the rest pose is a T-pose with identity rotations. */
export interface Rig {
  /** VRM 1.0 humanoid bones, parents first */
  names: string[];
  /** -1 for the root */
  parents: number[];
  /** offset from the parent, metres */
  rest: number[][];
}

/** What is heard with the motion of the same clock: speech and music, silence included. */
export interface SoundMessage {
  type: "audio";
  /** a sample index or a count of samples */
  at: number;
  epoch: number;
  /** utterance that speaks here; 0 is none */
  seg: number;
  /** s16le mono at `ready.sample_rate` */
  pcm: Uint8Array;
}

/** What the avatar does from `at` on. */
export interface StateMessage {
  type: "state";
  state: "acting" | "dancing" | "idle" | "listening" | "speaking";
  /** a sample index or a count of samples */
  at: number;
  /** utterance being spoken; 0 is none */
  seg: number;
  /** newest utterance whose last sample lies before `at` */
  finished: number;
}

/** The session's numbers, once a second. */
export interface StatsMessage {
  type: "stats";
  /** a sample index or a count of samples */
  at: number;
  /** sound waiting to become motion */
  queue_ms: number;
  /** motion sent ahead of playback */
  ahead_ms: number;
  /** last step of the engine */
  step_ms: number;
  /** engine work per second of motion; must stay below 1 */
  rtf: number;
  /** motion messages not sent because the connection was slow */
  dropped: number;
  /** gaps in playback, as `played` reported */
  underruns: number;
  sessions: number;
}

/** A word of speech, and when it is said. */
export interface Word {
  text: string;
  /** from the first sample of the utterance */
  start: number;
  end?: number | null;
}

/** Words of an utterance, in order, ahead of their sound or with it: some get a gesture that shows their meaning. */
export interface WordsMessage {
  type: "words";
  /** number of an utterance, growing, counted per speaker */
  seg: number;
  words: Word[];
}

export type ClientMessage = HelloMessage | AudioMessage | EndMessage | InterruptMessage | ActionMessage | MannerMessage | WordsMessage | MusicMessage | PlayedMessage | PingMessage;

export type ServerMessage = ReadyMessage | MotionMessage | SoundMessage | PackedSoundMessage | FlushMessage | ActionStatusMessage | StateMessage | StatsMessage | ErrorMessage | PongMessage;
