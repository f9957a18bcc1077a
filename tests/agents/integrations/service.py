"""A scripted ElevenLabs service on this machine."""

import base64
import itertools
import json
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response
from websockets.sync.server import ServerConnection, serve


class Talk:
    """One conversation: sends what the agent says, and records what the SDK answers."""

    def __init__(self, line: ServerConnection) -> None:
        self.line = line
        self.events = 0
        self.results: list[dict[str, Any]] = []
        self.user_chunks = 0

    def send(self, kind: str, **content: Any) -> None:
        self.line.send(json.dumps({"type": kind, **content}))

    def speak(self, samples: np.ndarray, rate: int, *texts: str) -> None:
        """Send speech as the service does: faster than playback, a quarter of a second per event.

        Each event may have a text, whose letters share its time and count from its beginning.
        """
        letters = iter(texts)
        for start in range(0, len(samples), rate // 4):
            self.events += 1
            part = samples[start : start + rate // 4].astype("<i2").tobytes()
            audio: dict[str, Any] = {"audio_base_64": base64.b64encode(part).decode(), "event_id": self.events}
            if text := next(letters, ""):
                ms = [250 * at // len(text) for at in range(len(text) + 1)]
                lasts = [b - a for a, b in itertools.pairwise(ms)]
                audio["alignment"] = {"chars": list(text), "char_start_times_ms": ms[:-1], "char_durations_ms": lasts}
            self.send("audio", audio_event=audio)

    def interrupt(self) -> None:
        self.send("interruption", interruption_event={"event_id": self.events})

    def call(self, name: str, **parameters: Any) -> dict[str, Any]:
        """Call a client tool and wait for its result."""
        call = {"tool_name": name, "tool_call_id": f"call-{len(self.results)}", "parameters": parameters}
        self.send("client_tool_call", client_tool_call=call)
        count = len(self.results)
        while len(self.results) == count:
            self.read(10)
        return self.results[-1]

    def read(self, seconds: float) -> None:
        message = json.loads(self.line.recv(timeout=seconds))
        if message.get("type") == "client_tool_result":
            self.results.append(message)
        elif "user_audio_chunk" in message:
            self.user_chunks += 1


@contextmanager
def service(script: Callable[[Talk], None]) -> Iterator[str]:
    """Run the service; yields its address. The script runs for each conversation, and its failure is raised here."""
    failed: list[BaseException] = []

    def answer(line: ServerConnection) -> None:
        talk = Talk(line)
        started = json.loads(line.recv(timeout=10))
        assert started["type"] == "conversation_initiation_client_data"
        metadata = {"conversation_id": "c1", "agent_output_audio_format": "pcm_24000"}
        talk.send("conversation_initiation_metadata", conversation_initiation_metadata_event=metadata)
        try:
            script(talk)
        except ConnectionClosed:
            pass
        except BaseException as error:
            failed.append(error)

    def sign(line: ServerConnection, request: Request) -> Response | None:
        """Answer the request for a signed conversation address, as their API does."""
        if "get-signed-url" not in request.path:
            return None
        port = line.socket.getsockname()[1]
        return line.respond(200, json.dumps({"signed_url": f"ws://127.0.0.1:{port}/v1/convai/conversation?signed=1"}))

    with serve(answer, "127.0.0.1", 0, process_request=sign) as server:
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        yield f"http://127.0.0.1:{server.socket.getsockname()[1]}"
        server.shutdown()
        thread.join(5)
    if failed:
        raise failed[0]
