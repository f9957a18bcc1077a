"""A server that answers like OpenAI's and ElevenLabs' text to speech: a tone as long as the text."""

import io
import json
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import numpy as np
import soundfile


class SpeechServer(ThreadingHTTPServer):
    """`asked` records requests (path, headers, content); `answers` are the status codes of the first answers."""

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), _Handler)
        self.asked: list[tuple[str, dict[str, str], dict[str, str]]] = []
        self.answers: list[int] = []
        self.is_sound = True
        self.says = ""

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.server_port}/v1"


class _Handler(BaseHTTPRequestHandler):
    server: SpeechServer

    def do_POST(self) -> None:
        content = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
        self.server.asked.append((self.path, {name.lower(): value for name, value in self.headers.items()}, content))
        status = self.server.answers.pop(0) if self.server.answers else 200
        text = content.get("input") or content.get("text")
        body = _tone(0.05 * len(text)) if self.server.is_sound else b"not a sound"
        if status != 200:
            body = self.server.says.encode()
        self.send_response(status)
        if status == 302:
            self.send_header("Location", self.server.url + "/elsewhere")
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, *_: object) -> None:
        pass


def _tone(seconds: float) -> bytes:
    """Syllables of 200 ms at 22.05 kHz."""
    time = np.arange(round(22_050 * seconds)) / 22_050
    samples = 0.4 * np.sin(2 * np.pi * 200 * time) * np.sin(np.pi * 5 * time) ** 2
    file = io.BytesIO()
    soundfile.write(file, samples, 22_050, format="WAV", subtype="PCM_16")
    return file.getvalue()


@contextmanager
def speech_server() -> Iterator[SpeechServer]:
    server = SpeechServer()
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02}, daemon=True)
    thread.start()
    try:
        yield server
    finally:
        server.shutdown()
        server.server_close()
        thread.join()
