"""Text to speech by a program of this machine, if it has one. No voice ships with us; no text leaves the machine."""

import shutil
import subprocess
import tempfile
from collections.abc import Mapping
from pathlib import Path

import anyio
import anyio.to_thread
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from echoavatar.errors import EchoAvatarError

from .clients import refusal
from .session_manager import SessionManager
from .tool_routes import answering, read_json

MAX_LETTERS = 600
_SECONDS = 20.0
_AT_ONCE = 2
# Programs, the most natural voice first. Text and sound go through files, so no text can be taken for an option.
_COMMANDS: Mapping[str, tuple[str, ...]] = {
    "say": ("-f", "{text}", "-o", "{wav}", "--data-format=LEI16@22050"),
    "flite": ("-voice", "rms", "-f", "{text}", "-o", "{wav}"),
    "espeak-ng": ("-s", "165", "-f", "{text}", "-w", "{wav}"),
    "espeak": ("-s", "165", "-f", "{text}", "-w", "{wav}"),
}


def find_voice() -> str:
    """Name of the program that speaks here; empty if there is none."""
    return next((name for name in _COMMANDS if shutil.which(name)), "")


def speak(voice: str, text: str) -> bytes:
    """A WAV file of the text. Raises EchoAvatarError if the text is empty or too long, or the program failed."""
    if not text.strip() or len(text) > MAX_LETTERS:
        raise EchoAvatarError(f"text of {len(text)} letters; say something, in at most {MAX_LETTERS}")
    try:
        with tempfile.TemporaryDirectory() as folder:
            source, wav = Path(folder) / "text.txt", Path(folder) / "speech.wav"
            source.write_text(text + "\n", "utf-8")
            options = [option.format(text=source, wav=wav) for option in _COMMANDS[voice]]
            subprocess.run([voice, *options], check=True, capture_output=True, timeout=_SECONDS)
            return wav.read_bytes()
    except (OSError, subprocess.SubprocessError) as error:
        raise EchoAvatarError(f"{voice} could not say that: {error}") from error


def voice_route(manager: SessionManager) -> Route:
    """GET names the voice, POST of `{"text": ...}` returns a WAV file."""
    voice = find_voice()
    limiter = anyio.CapacityLimiter(_AT_ONCE)

    async def answer(request: Request) -> object:
        if request.method != "POST":
            return {"voice": voice, "max_letters": MAX_LETTERS}
        if not voice:
            return refusal("no voice here; install espeak-ng or flite", 404)
        text = (await read_json(request, manager.settings.origins, most=8 * MAX_LETTERS)).get("text")
        if not isinstance(text, str):
            raise EchoAvatarError('send {"text": "..."}')
        wav = await anyio.to_thread.run_sync(speak, voice, text, limiter=limiter)
        return Response(wav, media_type="audio/wav")

    return Route("/v1/voice", answering(manager, answer), methods=["GET", "POST"])
