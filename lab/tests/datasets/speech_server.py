"""A server that answers like OpenAI's and ElevenLabs' text to speech: a tone as long as the text."""

import io
import json
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import soundfile
from tests.http_server import Handler, HttpServer, running


class SpeechServer(HttpServer):
    """`contents` records what was asked to be said; `answers` are the status codes of the first answers."""

    def __init__(self) -> None:
        super().__init__(self._answer)
        self.contents: list[dict[str, Any]] = []
        self.answers: list[int] = []
        self.is_sound = True
        self.says = ""

    @property
    def url(self) -> str:
        return f"{super().url}/v1"

    def _answer(self, handler: Handler) -> None:
        content = json.loads(handler.body)
        self.contents.append(content)
        status = self.answers.pop(0) if self.answers else 200
        if status != 200:
            return handler.answer(status, self.says.encode(), location=f"{self.url}/elsewhere")
        text = content.get("input") or content.get("text")
        return handler.answer(200, _tone(0.05 * len(text)) if self.is_sound else b"not a sound")


def _tone(seconds: float) -> bytes:
    """Syllables of 200 ms at 22.05 kHz."""
    time = np.arange(round(22_050 * seconds)) / 22_050
    samples = 0.4 * np.sin(2 * np.pi * 200 * time) * np.sin(np.pi * 5 * time) ** 2
    file = io.BytesIO()
    soundfile.write(file, samples, 22_050, format="WAV", subtype="PCM_16")
    return file.getvalue()


@contextmanager
def speech_server() -> Iterator[SpeechServer]:
    with running(SpeechServer()) as server:
        yield server
