"""Write the JSON Schema, the TypeScript types and the binary fixtures of the protocol; run after editing `wire`.

Run `python scripts/make_protocol.py`; a test fails when what is committed differs from what this writes.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import get_args

import msgspec
import numpy as np

from echoavatar.timing import FRAME_RATE_HZ, SAMPLE_RATE_HZ, SAMPLES_PER_FRAME
from echoavatar.wire.blobs import Pose, pack_audio, pack_pose, unpack_pose
from echoavatar.wire.codec import encode, subprotocol
from echoavatar.wire.messages import (
    CLOSE_CODES,
    ENCODINGS,
    MAX_MESSAGE_BYTES,
    PROTOCOL,
    VERSIONS,
    Action,
    ActionStatus,
    Audio,
    AudioFormat,
    ClientMessage,
    End,
    Error,
    Flush,
    Hello,
    Interrupt,
    Latency,
    Limits,
    Manner,
    Music,
    PackedSound,
    Ping,
    Played,
    Pong,
    Ready,
    Rig,
    ServerMessage,
    Sound,
    State,
    Stats,
    Word,
    Words,
)
from echoavatar_studio.typescript import Schema, interface

ROOT = Path(__file__).parents[1]
_HEADER = "// Made from src/echoavatar/wire/messages.py by scripts/make_protocol.py; do not edit."


def json_schema() -> Schema:
    """JSON Schema of all messages; `ClientMessage` and `ServerMessage` are in its `$defs`."""
    (client, server), parts = msgspec.json.schema_components([ClientMessage, ServerMessage])
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": f"echoavatar.v{VERSIONS[-1]}",
        "description": "Messages of the JSON twin; in MessagePack the base64 strings are binary.",
        "$defs": {**parts, "ClientMessage": client, "ServerMessage": server},
        "anyOf": [{"$ref": "#/$defs/ClientMessage"}, {"$ref": "#/$defs/ServerMessage"}],
    }


def typescript() -> str:
    """TypeScript types of all messages. Blobs are Uint8Array; fields that the server always sends are not optional."""
    _, parts = msgspec.json.schema_components([ClientMessage, ServerMessage])
    sent = {kind.__name__ for kind in get_args(ServerMessage)} | {"Rig", "Latency", "Limits"}
    blocks = [_HEADER, _constants()]
    blocks += [interface(name, schema, complete=name in sent, named=_named) for name, schema in sorted(parts.items())]
    for name, union in (("ClientMessage", ClientMessage), ("ServerMessage", ServerMessage)):
        kinds = " | ".join(_named(kind.__name__) for kind in get_args(union))
        blocks.append(f"export type {name} = {kinds};")
    return "\n\n".join(blocks) + "\n"


def _constants() -> str:
    values: Mapping[str, object] = {
        "VERSIONS": VERSIONS,
        "SUBPROTOCOLS": {kind: subprotocol(kind) for kind in ENCODINGS},
        "MAX_MESSAGE_BYTES": MAX_MESSAGE_BYTES,
        "SAMPLE_RATE": SAMPLE_RATE_HZ,
        "FRAME_RATE": FRAME_RATE_HZ,
        "SAMPLES_PER_FRAME": SAMPLES_PER_FRAME,
        "CLOSE_CODES": CLOSE_CODES,
    }
    return "\n".join(f"export const {name} = {_literal(value)};" for name, value in values.items())


def _literal(value: object) -> str:
    constant = not isinstance(value, int)
    return json.dumps(value, indent=2 if isinstance(value, dict) else None) + (" as const" if constant else "")


def _named(name: str) -> str:
    """Add a suffix to messages, because `Error` and `Audio` are names of the browser's own."""
    kinds = get_args(ClientMessage) + get_args(ServerMessage)
    return f"{name}Message" if name in {kind.__name__ for kind in kinds} else name


def example_pose() -> Pose:
    """Two frames of three joints, with rotations of both signs, and a face of four curves."""
    rotations = np.array(
        [
            [[1, 0, 0, 0], [0.8, 0.6, 0, 0], [-0.8, 0, 0.6, 0]],
            [[0.5, 0.5, -0.5, 0.5], [0, 1, 0, 0], [-0.1, 0.7, 0.1, -0.7]],
        ],
        np.float32,
    )
    rotations /= np.linalg.norm(rotations, axis=-1, keepdims=True)
    root = np.array([[0, 0.95, 0], [0.001, 0.9505, -2.25]], np.float32)
    return Pose(rotations, root, np.array([[0, 0.25, 0.5, 1], [1, 0.75, 0.1, 0]], np.float32))


def examples() -> dict[str, ClientMessage | ServerMessage]:
    """One message of every kind, by name."""
    tone = pack_audio(np.sin(np.arange(16) / 3).astype(np.float32))
    return {
        "hello": Hello(token="let me in", audio=AudioFormat(rate=48_000), seed=7),
        "hello_viewer": Hello(role="viewer", session="s-1", want=("motion",)),
        "hello_resume": Hello(resume="key", played=64_000),
        "audio_in": Audio(seg=1, start=0, pcm=tone),
        "audio_in_user": Audio(seg=1, start=16, pcm=tone, speaker="user"),
        "end": End(seg=1),
        "interrupt": Interrupt(heard=19_200, seg=1),
        "interrupt_unknown": Interrupt(),
        "action": Action(id="a1", name="wave", intensity=0.5, hold=1.5),
        "music_play": Music(id="m1", op="play", title="Evening"),
        "manner": Manner(liveliness=0.25),
        "words": Words(seg=3, words=(Word(text="Hello", start=0.0, end=0.25), Word(text="you", start=0.5))),
        "music_stop": Music(id="m2", op="stop"),
        "played": Played(at=12_800, epoch=1, underruns=2),
        "ping": Ping(nonce=2**40),
        "ready": Ready(
            version=1,
            server="echoavatar 0.1.0",
            session="s-1",
            resume="key",
            resumed=False,
            at=0,
            epoch=0,
            seg=0,
            received=0,
            sample_rate=24_000,
            frame_rate=30,
            chunk_samples=6_400,
            rig=Rig(
                names=("hips", "spine", "head"),
                parents=(-1, 0, 1),
                rest=((0.0, 0.95, 0.0), (0.0, 0.1, 0.0), (0.0, 0.5, 0.025)),
            ),
            face=("eyeBlinkLeft", "eyeBlinkRight", "jawOpen", "tongueOut"),
            actions=("wave", "bow"),
            tracks=("Evening",),
            latency=Latency(algorithm=266.7, compute=50.0),
            limits=Limits(),
        ),
        "motion": pack_pose(example_pose(), at=6_400, epoch=1, state="speaking"),
        "motion_no_face": pack_pose(example_pose()._replace(face=None), at=0),
        "audio_out": Sound(at=6_400, epoch=1, seg=1, pcm=tone),
        "opus": PackedSound(at=6_400, epoch=1, seg=1, skip=156, packets=(b"\x48\x0b", b"\x48")),
        "flush": Flush(at=19_200, epoch=2, seg=1, heard=16_000),
        "action_status": ActionStatus(
            id="a1", name="wawe", status="rejected", at=0, reason="no action 'wawe'", choices=("wave", "bow")
        ),
        "state": State(state="idle", at=32_000, seg=0, finished=1),
        "stats": Stats(
            at=32_000, queue_ms=0.0, ahead_ms=533.25, step_ms=48.5, rtf=0.25, dropped=0, underruns=2, sessions=3
        ),
        "error": Error(code="overloaded", message="all seats are taken", fatal=True, retry_after=5.0),
        "pong": Pong(nonce=2**40, at=32_000),
    }


def files() -> dict[Path, bytes]:
    """The generated files, by path from the repository's root."""
    made = {
        Path(f"docs/protocol.v{VERSIONS[-1]}.schema.json"): json.dumps(json_schema(), indent=1).encode() + b"\n",
        Path("web/packages/client/src/protocol.generated.ts"): typescript().encode(),
    }
    fixtures = Path("tests/fixtures/wire")
    for name, message in examples().items():
        made[fixtures / f"{name}.bin"] = encode(message)
        made[fixtures / f"{name}.json"] = encode(message, "json") + b"\n"
    pose = unpack_pose(examples()["motion"], joints=3, curves=4)  # type: ignore[arg-type]
    decoded = {
        "rotations_wxyz": pose.rotations.tolist(),
        "root": pose.root.tolist(),
        "face": None if pose.face is None else pose.face.tolist(),
    }
    made[fixtures / "motion.decoded.json"] = json.dumps(decoded).encode() + b"\n"
    return made


def main() -> None:
    """Write the files."""
    for path, content in files().items():
        (ROOT / path).parent.mkdir(parents=True, exist_ok=True)
        (ROOT / path).write_bytes(content)
        print(f"{path}  {len(content)} bytes")
    print(f"{PROTOCOL}.v{VERSIONS[-1]}")


if __name__ == "__main__":
    main()
