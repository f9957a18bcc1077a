"""All messages of protocol `echoavatar.v1`. The JSON Schema and the TypeScript types are generated from this file.

The clock counts samples at 24 kHz from the start of the session and runs through speech, music and silence alike. Every
`at` is such a sample index; no wall-clock time is sent. Unknown fields are ignored and new fields have defaults, so
versions stay compatible.
"""

from typing import Annotated, Literal

from msgspec import Meta, Struct

PROTOCOL = "echoavatar"
VERSIONS = (1,)
Encoding = Literal["msgpack", "json"]
ENCODINGS: tuple[Encoding, ...] = ("msgpack", "json")
MAX_MESSAGE_BYTES = 1 << 23  # a minute of speech at 48 kHz in one message, in base64

Samples = Annotated[int, Meta(ge=0, le=2**53 - 1, description="a sample index or a count of samples")]
Segment = Annotated[int, Meta(ge=0, le=2**31 - 1, description="number of an utterance, growing; 0 is none")]
Utterance = Annotated[int, Meta(ge=1, le=2**31 - 1, description="number of an utterance, growing, counted per speaker")]
Name = Annotated[str, Meta(max_length=128)]
Secret = Annotated[str, Meta(max_length=512)]

Role = Literal["source", "viewer"]
Speaker = Literal["avatar", "user"]
SampleFormat = Literal["s16le", "f32le"]
Stream = Literal["motion", "audio"]
SoundFormat = Literal["pcm", "opus"]
AvatarState = Literal["idle", "listening", "speaking", "dancing", "acting"]
ActionState = Literal["accepted", "started", "done", "rejected"]
ErrorCode = Literal[
    "bad_message",
    "bad_order",
    "bad_audio",
    "too_large",
    "unauthorized",
    "forbidden_origin",
    "unsupported_version",
    "unknown_session",
    "overloaded",
    "inbox_full",
    "timeout",
    "too_slow",
    "replaced",
    "shutting_down",
    "internal",
]

CLOSE_CODES: dict[ErrorCode, int] = {
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
    "shutting_down": 1012,
}


class _Message(Struct, frozen=True, kw_only=True, tag_field="type"):
    """A message is a map whose `type` names its kind."""


# ---------------------------------------------------------------------------------------------- client to server


class AudioFormat(Struct, frozen=True, kw_only=True):
    """Format of the bytes in `audio` messages; two channels are interleaved."""

    rate: Annotated[int, Meta(ge=8_000, le=192_000, description="samples per second")] = 24_000
    channels: Annotated[int, Meta(ge=1, le=2)] = 1
    format: SampleFormat = "s16le"

    @property
    def width(self) -> int:
        """Bytes of one sample of all channels."""
        return (2 if self.format == "s16le" else 4) * self.channels


Share = Annotated[float, Meta(ge=0, le=1)]


class BodyOptions(Struct, frozen=True, kw_only=True):
    """How the body moves. A camera that stands still loses a dancer who is free to walk."""

    leash_m: Annotated[
        float, Meta(ge=0, le=100, description="metres the hips may be from where they started; 0: no leash")
    ] = 0.0
    in_place: Annotated[bool, Meta(description="hips stay over the start")] = False
    upper_body: Annotated[bool, Meta(description="hips and legs stand idle, everything above moves")] = False
    liveliness: Annotated[Share | None, Meta(description="0: hardly a gesture, 1: a storyteller; absent: by seed")] = (
        None
    )
    handedness: Annotated[Share | None, Meta(description="hand of one-handed gestures, 0: left; absent: by seed")] = (
        None
    )
    eye_contact: Annotated[
        Share, Meta(description="share of the time in which the eyes meet the viewer while the avatar speaks")
    ] = 0.5
    feeling: Annotated[Share, Meta(description="how far the face shows what the voice feels, 0: not at all")] = 0.8


class Hello(_Message, frozen=True, kw_only=True, tag="hello"):
    """The first message, sent once. A source sends sound; a viewer joins a running session and watches."""

    versions: Annotated[tuple[int, ...], Meta(min_length=1, max_length=16)] = (1,)
    role: Role = "source"
    token: Secret = ""
    audio: AudioFormat = AudioFormat()
    want: Annotated[tuple[Stream, ...], Meta(max_length=4, description="streams to be sent")] = ("motion", "audio")
    sound: Annotated[
        tuple[Name, ...], Meta(max_length=8, description="how sound may be sent: pcm, opus; unknown names are ignored")
    ] = ("pcm",)
    session: Annotated[Name, Meta(description="viewer: the session to watch")] = ""
    resume: Annotated[Secret, Meta(description="the key of `ready`, to resume after the connection broke")] = ""
    played: Annotated[
        Samples, Meta(description="resuming: everything before it was received; the rest is sent again")
    ] = 0
    epoch: Annotated[
        int | None, Meta(description="resuming: the newest one received; a `flush` missed since is sent again")
    ] = None
    ticket: Annotated[
        Name, Meta(description="any text that no other client has; repeating it soon keeps the place in the queue")
    ] = ""
    seed: Annotated[int, Meta(ge=0, le=2**31 - 1, description="equal seed and sound give equal motion")] = 0
    body: Annotated[BodyOptions, Meta(description="for a new session; a resumed one keeps its own")] = BodyOptions()


class Audio(_Message, frozen=True, kw_only=True, tag="audio"):
    """Sound of one utterance, in order, as fast as the source likes (the inbox is bounded: `ready.limits`)."""

    seg: Utterance
    start: Annotated[Samples, Meta(description="samples (per channel, source rate) of `seg` sent before these")]
    pcm: bytes
    speaker: Annotated[Speaker, Meta(description="user: the avatar listens to it; it is not played")] = "avatar"


class End(_Message, frozen=True, kw_only=True, tag="end"):
    """The utterance is complete; silence follows until the next one."""

    seg: Utterance
    speaker: Speaker = "avatar"


class Interrupt(_Message, frozen=True, kw_only=True, tag="interrupt"):
    """Stop at once: discard all sound from `heard` on, and utterances up to `seg`, as if they had never been sent."""

    heard: Annotated[
        Samples | None, Meta(description="clock: first sample not heard; absent: that of the last `played`")
    ] = None
    seg: Annotated[Segment, Meta(description="0: the newest utterance known")] = 0


class Action(_Message, frozen=True, kw_only=True, tag="action"):
    """Perform one of `ready.actions`; answered by `action_status` with the same id."""

    id: Annotated[Name, Meta(min_length=1)]
    name: Name
    intensity: Annotated[float, Meta(ge=0, le=2, description="size of its movements; 1: as in its clip")] = 1.0
    hold: Annotated[float, Meta(ge=0, le=60, description="seconds; absent: the action's own length")] | None = None


class Manner(_Message, frozen=True, kw_only=True, tag="manner"):
    """How the speaker gestures from the next chunk on; what is absent stays as it is. See `ready.manner`."""

    liveliness: Annotated[Share | None, Meta(description="0: hardly a gesture, 1: a storyteller")] = None
    handedness: Annotated[Share | None, Meta(description="hand of one-handed gestures, 0: left, 1: right")] = None


Seconds = Annotated[float, Meta(ge=0, le=86_400, description="from the first sample of the utterance")]


class Word(Struct, frozen=True, kw_only=True):
    """A word of speech, and when it is said."""

    text: Annotated[str, Meta(max_length=100)]
    start: Seconds
    end: Seconds | None = None


class Words(_Message, frozen=True, kw_only=True, tag="words"):
    """Words of an utterance, in order, ahead of their sound or with it: some get a gesture that shows their meaning."""

    seg: Utterance
    words: Annotated[tuple[Word, ...], Meta(max_length=2_000)]


class Music(_Message, frozen=True, kw_only=True, tag="music"):
    """Play one of `ready.tracks` (the first if there is no title), or stop; answered by `action_status`."""

    id: Annotated[Name, Meta(min_length=1)]
    op: Literal["play", "stop"]
    title: Name = ""


class Played(_Message, frozen=True, kw_only=True, tag="played"):
    """The playback position, five times a second. Motion goes at most `limits.ahead_seconds` beyond the source's."""

    at: Annotated[Samples, Meta(description="clock: first sample not yet heard")]
    epoch: Annotated[int, Meta(ge=0, description="epoch of the newest `flush` or `ready` processed")] = 0
    underruns: Annotated[int, Meta(ge=0, description="gaps in playback so far")] = 0


class Ping(_Message, frozen=True, kw_only=True, tag="ping"):
    """Answered at once by `pong` with the same number."""

    nonce: Annotated[int, Meta(ge=0, le=2**53 - 1)] = 0


ClientMessage = Hello | Audio | End | Interrupt | Action | Manner | Words | Music | Played | Ping


# ---------------------------------------------------------------------------------------------- server to client


class Rig(Struct, frozen=True, kw_only=True):
    """The skeleton: metres, Y up, facing +Z, left at +X; the rest pose is a T-pose with identity rotations."""

    names: Annotated[tuple[str, ...], Meta(description="VRM 1.0 humanoid bones, parents first")]
    parents: Annotated[tuple[int, ...], Meta(description="-1 for the root")]
    rest: Annotated[tuple[tuple[float, ...], ...], Meta(description="offset from the parent, metres")]


class Latency(Struct, frozen=True, kw_only=True):
    """Milliseconds from the arrival of a sample to the departure of its motion."""

    algorithm: Annotated[float, Meta(description="waiting for a whole chunk")]
    compute: Annotated[float, Meta(description="one step, as measured")]


class Limits(Struct, frozen=True, kw_only=True):
    """How much the server holds, and for how long."""

    message_bytes: int = MAX_MESSAGE_BYTES
    inbox_seconds: Annotated[float, Meta(description="sound that may wait to become motion")] = 600.0
    ahead_seconds: Annotated[float, Meta(description="motion is never sent further ahead of playback")] = 2.0
    resume_seconds: Annotated[float, Meta(description="how long a session waits for its source to return")] = 30.0
    ping_seconds: Annotated[float, Meta(description="the client sends something at least this often")] = 30.0


class Ready(_Message, frozen=True, kw_only=True, tag="ready"):
    """The answer to `hello`: everything that stays constant, once."""

    version: int
    server: str
    session: Annotated[str, Meta(description="its public name, for viewers")]
    resume: Annotated[str, Meta(description="its key, for the source alone; empty for viewers")]
    resumed: bool
    at: Annotated[Samples, Meta(description="clock of the next motion")]
    epoch: int
    seg: Annotated[Segment, Meta(description="resumed: newest utterance known")]
    received: Annotated[Samples, Meta(description="resumed: samples of `seg` received, source rate")]
    sample_rate: int
    frame_rate: int
    chunk_samples: int
    rig: Rig
    face: Annotated[tuple[str, ...], Meta(description="ARKit names, in order; empty without a face")]
    actions: tuple[str, ...]
    tracks: tuple[str, ...]
    manner: Annotated[tuple[str, ...], Meta(description="fields of `manner` that this model follows")] = ()
    latency: Latency
    limits: Limits
    sound: Annotated[SoundFormat, Meta(description="opus: most sound comes as `opus` messages, not `audio`")] = "pcm"


class Motion(_Message, frozen=True, kw_only=True, tag="motion"):
    """Consecutive frames of body and face, 800 samples each; see `blobs` for the bytes."""

    at: Annotated[Samples, Meta(description="clock of the first frame")]
    epoch: int
    frames: int
    rotations: Annotated[bytes, Meta(description="i16le [frames][joints][x y z w] / 32767, parent-relative")]
    root: Annotated[bytes, Meta(description="f32le [frames][x y z] metres, of the hips")]
    face: Annotated[bytes, Meta(description="u8 [frames][names] / 255; empty without a face")]
    state: AvatarState


class Sound(_Message, frozen=True, kw_only=True, tag="audio"):
    """What is heard with the motion of the same clock: speech and music, silence included."""

    at: Samples
    epoch: int
    seg: Annotated[Segment, Meta(description="utterance that speaks here; 0 is none")]
    pcm: Annotated[bytes, Meta(description="s16le mono at `ready.sample_rate`")]


class PackedSound(_Message, frozen=True, kw_only=True, tag="opus"):
    """The sound of `audio` as Opus, for clients whose `hello.sound` has it. It lags motion by less than 27 ms."""

    at: Annotated[Samples, Meta(description="clock of the first sample decoded, after `skip`")]
    epoch: int
    seg: Annotated[Segment, Meta(description="utterance that speaks here; 0 is none")]
    skip: Annotated[int, Meta(ge=0, description="samples to drop first, at 24 kHz; above 0: begin with a new decoder")]
    packets: Annotated[tuple[bytes, ...], Meta(description="20 ms each, mono")]


class Flush(_Message, frozen=True, kw_only=True, tag="flush"):
    """Motion and audio from `at` on are void: drop them, and hold the pose at `at` until new motion arrives."""

    at: Samples
    epoch: Annotated[int, Meta(description="epoch of all that follows; messages of older epochs are stale")]
    seg: Annotated[Segment, Meta(description="the utterance cut off; 0 is none")]
    heard: Annotated[Samples, Meta(description="samples of `seg` heard, at 24 kHz")]


class ActionStatus(_Message, frozen=True, kw_only=True, tag="action_status"):
    """The status of an `action` or `music` message."""

    id: str
    name: str
    status: ActionState
    at: Samples
    reason: str
    choices: Annotated[tuple[str, ...], Meta(description="rejected names: what there is instead")]


class State(_Message, frozen=True, kw_only=True, tag="state"):
    """What the avatar does from `at` on."""

    state: AvatarState
    at: Samples
    seg: Annotated[Segment, Meta(description="utterance being spoken; 0 is none")]
    finished: Annotated[Segment, Meta(description="newest utterance whose last sample lies before `at`")]


class Stats(_Message, frozen=True, kw_only=True, tag="stats"):
    """The session's numbers, once a second."""

    at: Samples
    queue_ms: Annotated[float, Meta(description="sound waiting to become motion")]
    ahead_ms: Annotated[float, Meta(description="motion sent ahead of playback")]
    step_ms: Annotated[float, Meta(description="last step of the engine")]
    rtf: Annotated[float, Meta(description="engine work per second of motion; must stay below 1")]
    dropped: Annotated[int, Meta(description="motion messages not sent because the connection was slow")]
    underruns: Annotated[int, Meta(description="gaps in playback, as `played` reported")]
    sessions: int


class Error(_Message, frozen=True, kw_only=True, tag="error"):
    """What went wrong. After a `fatal` error the connection is closed with the code's number in `CLOSE_CODES`."""

    code: ErrorCode
    message: str
    fatal: bool
    retry_after: Annotated[float, Meta(description="seconds; 0: trying again will not help")]
    place: Annotated[int, Meta(description="overloaded: place in the queue of tickets, from 1 on; 0: none")] = 0


class Pong(_Message, frozen=True, kw_only=True, tag="pong"):
    """The answer to `ping`."""

    nonce: int
    at: Samples


ServerMessage = Ready | Motion | Sound | PackedSound | Flush | ActionStatus | State | Stats | Error | Pong
