"""The page of live video in a real browser: WebRTC pictures that move and sound, from the real server."""

import subprocess
import sys
import time
from importlib.resources import files
from itertools import pairwise

import numpy as np
import pytest
import soundfile
from tests.web.conftest import free_port, serving

pytest.importorskip("aiortc", reason="pip install 'echoavatar[video]'")

pytestmark = pytest.mark.browser
PATIENCE = 120  # seconds; the machine that runs this may be busy
SPEECH = str(files("echoavatar") / "assets" / "speech.ogg")
# What the element shows, as a small grey picture.
LOOK = """() => {
  const canvas = Object.assign(document.createElement("canvas"), { width: 64, height: 64 });
  const context = canvas.getContext("2d");
  context.drawImage(document.getElementById("picture"), 0, 0, 64, 64);
  return [...context.getImageData(0, 0, 64, 64).data].filter((_, k) => k % 4 === 1);
}"""
# Decodes the sound track once more, beside the element, and keeps the loudest sample so far.
HEAR = """() => {
  const context = new AudioContext();
  const analyser = context.createAnalyser();
  context.createMediaStreamSource(document.getElementById("picture").srcObject).connect(analyser);
  const samples = new Float32Array(analyser.fftSize);
  window.loudest = 0;
  setInterval(() => {
    analyser.getFloatTimeDomainData(samples);
    for (const sample of samples) loudest = Math.max(loudest, Math.abs(sample));
  }, 30);
}"""


@pytest.fixture(scope="module")
def video_url():
    """The real server with one renderer, and the default bundle."""
    port = free_port()
    command = [sys.executable, "-m", "echoavatar", "serve", "--video", "1", "--port", str(port)]
    yield from serving(command, port)


@pytest.fixture
def speaker(video_url, tmp_path):
    """A program of its own, which lets the avatar speak the bundled speech for two minutes."""
    speech, rate = soundfile.read(SPEECH)
    soundfile.write(tmp_path / "speech.wav", np.tile(speech, 1 + int(120 * rate / len(speech))), rate)
    talk = ["say", str(tmp_path / "speech.wav"), "--live", "--server", video_url.rstrip("/")]
    command = [sys.executable, "-m", "echoavatar", *talk]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    yield process
    process.kill()
    process.wait()


def test_the_avatar_moves_and_is_heard(new_page, video_url, speaker, tmp_path):
    """From the page that waits for a session, through the picture, to the sound behind its button."""
    driver = new_page(512, 580)
    driver.page.goto(f"{video_url}video?view=bust", wait_until="commit", timeout=120_000)
    state, picture = (f"document.getElementById('{name}')" for name in ("state", "picture"))
    driver.wait(f"{state}.textContent === 'Live' && {picture}.videoWidth > 0 && {picture}.currentTime > 0", PATIENCE)
    assert driver.ask(f"[{picture}.videoWidth, {picture}.videoHeight]") == [512, 512]
    kinds = driver.ask(f"{picture}.srcObject.getTracks().map((track) => track.kind).sort()")
    assert kinds == ["audio", "video"]
    driver.page.locator("#sound").click(force=True)
    assert driver.ask(f"{picture}.muted") is False
    driver.page.evaluate(HEAR)
    driver.wait("window.loudest > 0.02", PATIENCE)
    looks = []
    for _ in range(12):
        looks.append(np.array(driver.page.evaluate(LOOK), float).reshape(64, 64))
        time.sleep(0.25)
    driver.shot(tmp_path / "video.png")
    assert looks[0].std() > 10, "a picture of one colour"
    changed = [np.abs(after - before) > 8 for before, after in pairwise(looks)]
    assert np.mean(changed) > 0.002, "a picture that stands still"
    corner = np.array([mask[:8, :8].mean() for mask in changed])  # the backdrop
    assert corner.mean() < 0.02, "a picture that flickers as a whole"
    assert speaker.poll() is None
    assert [text for text in driver.problems if "404" not in text] == []  # it had asked before there was a session
