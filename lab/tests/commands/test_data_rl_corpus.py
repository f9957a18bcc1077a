"""From the command line to a tuned generator, without a motion recording but the reference_statistics's."""

from pathlib import Path

import pytest
from lab.tests.align.moving_bodies import reference_statistics
from lab.tests.datasets.speech_server import speech_server
from lab.tests.datasets.test_rl_corpus import clicks

from echoavatar.cli import main
from echoavatar.models.audio.io import write_wav
from echoavatar_lab.data import SoundSet


@pytest.fixture
def words(tmp_path: Path) -> list[str]:
    (tmp_path / "music").mkdir()
    for number in range(2):
        write_wav(tmp_path / f"music/{number}.wav", clicks(4.5))
    folders = ["-o", str(tmp_path / "sounds"), "--music", str(tmp_path / "music")]
    return ["data", "rl-corpus", *folders, "--pieces", "2", "--hours", "0"]


def test_sounds_become_prompts_and_prompts_a_tuned_generator(
    tmp_path: Path, tiny_bundle: Path, words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*words, "--model", str(tiny_bundle)]) == 0
    assert "music: 2 recordings, 0.1 minutes, 0 held out" in capsys.readouterr().out
    tokens, measure = tmp_path / "sounds/tokens", tmp_path / "reference_statistics.json"
    tune = ["align", "grpo", str(tokens), "-o", str(tmp_path / "run"), "--model", str(tiny_bundle)]
    tune += ["--recipe", "tiny", "--fewest-events", "0", "--steps", "1"]
    assert main(tune) == 1
    assert "pass the --reference-statistics" in capsys.readouterr().err
    reference_statistics().save(measure)
    assert main([*tune, "--reference-statistics", str(measure)]) == 0
    assert (tmp_path / "run/model.safetensors").exists()
    parts = ["--codec", str(tiny_bundle / "codec"), "--tokenizer", str(tiny_bundle / "tokenizer")]
    assert main(["train", "generator", str(tokens), "-o", str(tmp_path / "g"), *parts]) == 1
    assert "motion that a generator made" in capsys.readouterr().err


def test_a_service_speaks_and_failures_are_reported(
    tmp_path: Path, words: list[str], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("OPENAI_API_KEY", "sk-secret")
    (tmp_path / "talk.txt").write_text(
        "A: First of all, hello to everybody here.\n\nRefused.\n\nB: And goodbye, too.\n"
    )
    (tmp_path / "music/bad.wav").write_bytes(b"RIFF")
    words[words.index("--hours") + 1] = str(2.5 / 3600)
    words[words.index("--pieces") + 1] = "3"
    words += ["--tts", "openai", "--scripts", str(tmp_path / "talk.txt"), "--scripts-licence", "mine", "--strict"]
    with speech_server() as server:
        server.answers = [200, 400]
        assert main([*words, "--tts-url", server.url]) == 1
    out = capsys.readouterr().out
    assert "failed: speech-file-0001  127.0.0.1, gpt-4o-mini-tts refuses the text (400)" in out
    assert "bad.wav is not a sound file" in out
    spoken = [sound for sound in SoundSet(tmp_path / "sounds").sounds if sound.kind == "speech"]
    assert [sound.name for sound in spoken] == ["speech-file-0000", "speech-file-0002"]
    assert spoken[0].licence == "text: mine; voices: the terms of 127.0.0.1"
    assert "sk-secret" not in (tmp_path / "sounds/sounds.json").read_text()
