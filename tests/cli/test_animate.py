import io
import json
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import soundfile
from tests.files.exports.bodies import make_rigs

from echoavatar.cli import main
from echoavatar.files.avatar.avatar_renderer import RENDERERS
from echoavatar.files.avatar.render import Renderer, Surface
from echoavatar.motion.arkit import ARKIT_NAMES
from echoavatar.motion.formats import read_bvh
from echoavatar.motion.formats.tables import read_npz
from echoavatar_lab.models.face.clip import read_live_link


@pytest.fixture
def wav(tmp_path: Path, voice: np.ndarray) -> Path:
    path = tmp_path / "voice.wav"
    soundfile.write(path, voice, 24_000)
    return path


def run(audio: Path, output: Path, bundle: Path, *more: str) -> int:
    return main(["animate", str(audio), "-o", str(output), "--model", str(bundle), *more])


@pytest.mark.parametrize("suffix", [".bvh", ".glb", ".npz", ".csv"])
def test_every_format_is_written(wav: Path, tmp_path: Path, tiny_bundle: Path, suffix: str) -> None:
    path = tmp_path / f"out{suffix}"
    assert run(wav, path, tiny_bundle) == 0
    assert path.stat().st_size > 10_000
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted(["voice.wav", path.name])  # nothing half-written


def test_the_mp4_shows_and_sounds(wav: Path, tmp_path: Path, tiny_bundle: Path, voice: np.ndarray) -> None:
    import av

    soundfile.write(wav, voice[:4800], 24_000)
    assert run(wav, tmp_path / "out.mp4", tiny_bundle) == 0
    with av.open(str(tmp_path / "out.mp4")) as container:
        assert len(container.streams.video) == len(container.streams.audio) == 1
        assert sum(1 for _ in container.decode(video=0)) == 6


def test_a_film_shows_the_character_of_a_rig(
    wav: Path, tmp_path: Path, tiny_bundle: Path, voice: np.ndarray, capsys: pytest.CaptureFixture[str]
) -> None:
    """A skeleton has nothing to film, and a film shows one character: both are said before any work."""
    import av

    rigs = make_rigs(tmp_path)
    soundfile.write(wav, voice[:2400], 24_000)
    child = ("--rig", str(rigs["child"]))
    assert run(wav, tmp_path / "out.mp4", tiny_bundle, *child, "--size", "portrait", "--view", "bust") == 0
    with av.open(str(tmp_path / "out.mp4")) as container:
        assert container.streams.video[0].height == 1280
        pixels = next(container.decode(video=0)).to_ndarray(format="rgb24").astype(int)
    is_red = (pixels[..., 0] > 150) & (pixels[..., 1] < 110)
    assert is_red.sum() > 500  # the child's mouth
    capsys.readouterr()
    for words, said in (
        (("--rig", str(rigs["tall"])), "tall.bvh is a skeleton without a mesh to film"),
        ((*child, "--character", "theo"), "leave one of the two out"),
    ):
        assert run(wav, tmp_path / "out.mp4", tiny_bundle, *words) == 1
        assert said in capsys.readouterr().err


def test_another_renderer_draws_the_film(
    wav: Path, tmp_path: Path, tiny_bundle: Path, voice: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn = []

    class Counted(Renderer):
        def draw(self, surface: Surface) -> np.ndarray:
            drawn.append((self.width, self.height))
            return super().draw(surface)

    monkeypatch.setitem(RENDERERS, "gpu", Counted)
    soundfile.write(wav, voice[:4800], 24_000)
    assert run(wav, tmp_path / "out.mp4", tiny_bundle, "--size", "64x48", "--renderer", "gpu") == 0
    assert drawn == [(64, 48)] * 6


def test_a_renderer_that_is_missing_is_told_before_any_work(
    wav: Path, tmp_path: Path, tiny_bundle: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "moderngl", None)
    assert run(wav, tmp_path / "out.mp4", tiny_bundle, "--renderer", "gpu") == 1
    told = capsys.readouterr()
    assert "pip install 'echoavatar[gpu]'" in told.err
    assert (told.err.count("\n"), told.out) == (1, "")


def test_sixty_frames_a_second_pass_through_the_thirty(wav: Path, tmp_path: Path, tiny_bundle: Path) -> None:
    assert run(wav, tmp_path / "a.bvh", tiny_bundle) == 0
    assert run(wav, tmp_path / "b.bvh", tiny_bundle, "--fps", "60") == 0
    slow, fast = read_bvh(tmp_path / "a.bvh"), read_bvh(tmp_path / "b.bvh")
    assert (slow.frames, fast.frames) == (60, 120)
    np.testing.assert_allclose(fast.root[::2], slow.root, atol=1e-4)


def test_the_face_is_in_every_format_that_has_room(wav: Path, tmp_path: Path, bundle_with_face: Path) -> None:
    for name in ("a.npz", "a.glb", "a.csv", "b.face.csv"):
        assert run(wav, tmp_path / name, bundle_with_face) == 0
    with np.load(tmp_path / "a.npz") as stored:
        face = stored["face"]
        assert tuple(stored["face_names"]) == ARKIT_NAMES
    assert face.shape == (60, 52)
    assert 0.05 < face.mean() < 0.6
    glb = (tmp_path / "a.glb").read_bytes()
    document = json.loads(glb[20 : 20 + int.from_bytes(glb[12:16], "little")])
    assert any(c["target"]["path"] == "weights" for c in document["animations"][0]["channels"])
    for name in ("a.face.csv", "b.face.csv"):
        np.testing.assert_allclose(read_live_link(tmp_path / name), face, atol=1e-4)
    assert read_npz(tmp_path / "a.npz").frames == 60


def test_the_face_can_be_left_out(wav: Path, tmp_path: Path, bundle_with_face: Path) -> None:
    assert run(wav, tmp_path / "a.npz", bundle_with_face, "--without", "face") == 0
    with np.load(tmp_path / "a.npz") as stored:
        assert "face" not in stored


def test_a_take_without_a_face_model_is_refused(
    wav: Path, tmp_path: Path, tiny_bundle: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("b.face.csv", "b.face47.csv"):
        assert run(wav, tmp_path / name, tiny_bundle) == 1
        assert "no face" in capsys.readouterr().err


def test_in_place_and_upper_body_do_what_they_say(wav: Path, tmp_path: Path, tiny_bundle: Path) -> None:
    assert run(wav, tmp_path / "a.npz", tiny_bundle, "--in-place") == 0
    assert run(wav, tmp_path / "b.npz", tiny_bundle, "--upper-body") == 0
    assert np.ptp(read_npz(tmp_path / "a.npz").root[:, [0, 2]], axis=0).max() == 0
    assert np.ptp(read_npz(tmp_path / "b.npz").rotations[:, 0], axis=0).max() == 0


def test_a_stage_left_out_is_left_out(
    wav: Path, tmp_path: Path, tiny_bundle: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    every = ("smoother", "stillness", "ground", "leash", "feet", "hands")
    assert run(wav, tmp_path / "a.npz", tiny_bundle) == 0
    assert run(wav, tmp_path / "b.npz", tiny_bundle, *(f"--without={stage}" for stage in every)) == 0
    refined, raw = (read_npz(tmp_path / f"{name}.npz").rotations for name in "ab")
    assert np.abs(refined - raw).max() > 1e-3
    assert run(wav, tmp_path / "c.npz", tiny_bundle, "--without", "toes") == 1
    assert "no stage 'toes'" in capsys.readouterr().err
    assert run(wav, tmp_path / "c.npz", tiny_bundle, "--in-place", "--without", "leash") == 1
    assert "drop one of the two" in capsys.readouterr().err
    assert not (tmp_path / "c.npz").exists()


def write_bad(path: Path, kind: str) -> None:
    noise = np.random.default_rng(0).standard_normal(24_000) * 0.2
    if kind == "empty":
        path.write_bytes(b"")
    elif kind == "text":
        path.write_text("this is not sound\n" * 50)
    elif kind == "nan":
        soundfile.write(path, np.array([0.0, np.nan, 0.5], np.float32), 24_000, format="WAV", subtype="FLOAT")
    elif kind == "no samples":
        soundfile.write(path, np.zeros(0), 24_000, format="WAV")
    elif kind == "truncated":
        soundfile.write(path, noise, 24_000, format="MP3")
        path.write_bytes(path.read_bytes()[:100])


@pytest.mark.parametrize("kind", ["empty", "text", "nan", "no samples", "truncated", "missing"])
def test_bad_sound_is_one_line_and_leaves_nothing(
    tmp_path: Path, tiny_bundle: Path, kind: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "bad.bin"
    write_bad(path, kind)
    assert run(path, tmp_path / "out.bvh", tiny_bundle) == 1
    error = capsys.readouterr().err.strip().splitlines()[-1]
    assert error.startswith("echoavatar: ")
    assert not (tmp_path / "out.bvh").exists()


@pytest.mark.parametrize(
    ("rate", "shape", "scale"),
    [
        (8_000, (8_000,), 0.2),
        (96_000, (48_000, 6), 0.2),
        (24_000, (240,), 0.2),
        (24_000, (24_000,), 0.0),
        (24_000, (24_000,), 9.0),
    ],
    ids=["8 kHz", "96 kHz, 6 channels", "10 ms", "silence", "clipping"],
)
def test_unusual_sound_still_moves(
    tmp_path: Path, tiny_bundle: Path, rate: int, shape: tuple[int, ...], scale: float
) -> None:
    sound = np.clip(np.random.default_rng(0).standard_normal(shape) * scale, -1, 1)
    soundfile.write(tmp_path / "in.wav", sound, rate)
    assert run(tmp_path / "in.wav", tmp_path / "out.npz", tiny_bundle) == 0
    motion = read_npz(tmp_path / "out.npz")
    assert motion.frames == -(-shape[0] * 30 // rate)
    assert np.isfinite(motion.rotations).all()


@pytest.mark.parametrize(
    ("output", "complaint"),
    [("out.xyz", "use one of .bvh"), ("no/such/folder/out.bvh", "not a folder"), ("taken.bvh", "choose another")],
)
def test_outputs_that_cannot_be_are_refused_before_any_work(
    wav: Path, tmp_path: Path, output: str, complaint: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "taken.bvh").mkdir()
    assert run(wav, tmp_path / output, Path("never-loaded")) == 1
    assert complaint in capsys.readouterr().err


def test_what_is_no_sound_is_told_before_the_model_is_loaded(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "a.wav").write_text("<html>not found</html>")
    assert run(tmp_path / "a.wav", tmp_path / "a.bvh", Path("never-loaded")) == 1
    assert "a.wav is not a sound file but a web page" in capsys.readouterr().err


def test_several_sounds_go_into_a_folder(wav: Path, tmp_path: Path, tiny_bundle: Path) -> None:
    second = tmp_path / "second.wav"
    second.write_bytes(wav.read_bytes())
    words = [
        "animate",
        str(wav),
        str(second),
        "-o",
        str(tmp_path / "out"),
        "--format",
        "bvh",
        "--model",
        str(tiny_bundle),
    ]
    assert main(words) == 0
    assert {path.name for path in (tmp_path / "out").iterdir()} == {f"{wav.stem}.bvh", "second.bvh"}
    one, other = (read_bvh(path).root for path in sorted((tmp_path / "out").iterdir()))
    np.testing.assert_array_equal(one, other)


def test_sound_comes_from_standard_input(
    wav: Path, tmp_path: Path, tiny_bundle: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.stdin", SimpleNamespace(buffer=io.BytesIO(wav.read_bytes())))
    assert run(Path("-"), tmp_path / "a.bvh", tiny_bundle) == 0
    assert run(wav, tmp_path / "b.bvh", tiny_bundle) == 0
    assert (tmp_path / "a.bvh").read_bytes() == (tmp_path / "b.bvh").read_bytes()


def test_empty_standard_input_is_named(
    tmp_path: Path, tiny_bundle: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.stdin", SimpleNamespace(buffer=io.BytesIO()))
    assert run(Path("-"), tmp_path / "a.bvh", tiny_bundle) == 1
    assert "echoavatar: standard input is empty (0 bytes)" in capsys.readouterr().err


def test_endless_standard_input_is_refused(
    tmp_path: Path, tiny_bundle: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("echoavatar.cli.batch.STDIN_BYTES", 1 << 21)
    with open("/dev/zero", "rb") as endless:
        monkeypatch.setattr("sys.stdin", SimpleNamespace(buffer=endless))
        assert run(Path("-"), tmp_path / "a.bvh", tiny_bundle) == 1
    assert "more than 2,097,152 bytes" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_any_frame_rate(wav: Path, tmp_path: Path, tiny_bundle: Path) -> None:
    assert run(wav, tmp_path / "a.bvh", tiny_bundle, "--fps", "12.5") == 0
    assert read_bvh(tmp_path / "a.bvh").fps == 12.5


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["a.wav", "b.wav", "-o", "x.glb"], "several sounds need a folder"),
        (["a/x.wav", "b/x.mp3", "-o", "out"], "called 'x'"),
        (["-", "-", "-o", "out"], "read once"),
        (["x.bvh", "-o", "x.bvh"], "is the sound itself"),
    ],
)
def test_outputs_that_would_collide_are_refused(
    words: list[str], said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["animate", *words]) == 1
    assert said in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["https://a.org/x.wav", "-o", "x.glb"], "is an address; download it first"),
        (["x.wav", "-o", "x.mp4", "--size", "tall"], "write it as 1280x720, or wide, portrait, square"),
        (["x.wav", "-o", "x.mp4", "--size", "101x64"], "even"),
        (["x.wav", "-o", "x.mp4", "--fps", "0"], "not a frame rate"),
        (["x.wav", "-o", "x.mp4", "--fps", "fast"], "'fast' is not a frame rate from 1 to 1000"),
    ],
)
def test_arguments_that_mean_nothing_are_refused(
    words: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        main(["animate", *words])
    assert said in capsys.readouterr().err


def test_the_runtime_reaches_the_motion(wav: Path, tmp_path: Path, tiny_bundle: Path) -> None:
    for how in ("paper", "default"):
        assert run(wav, tmp_path / f"{how}.npz", tiny_bundle, "--runtime", how) == 0
    paper, default = (read_npz(tmp_path / f"{how}.npz") for how in ("paper", "default"))
    assert (paper.fps, default.fps) == (60, 30)  # paper, Settings: interpolated to 60 for rendering
    shown = paper.rotations[::2]
    assert np.abs(shown - default.rotations[: len(shown)]).max() > 1e-4


def test_the_papers_60_fps_can_be_chosen_otherwise_and_the_runtime_is_told(
    wav: Path, tmp_path: Path, tiny_bundle: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(wav, tmp_path / "a.npz", tiny_bundle, "--runtime", "paper", "--fps", "30") == 0
    assert read_npz(tmp_path / "a.npz").fps == 30
    assert capsys.readouterr().out.strip().endswith("runtime: paper")
    assert run(wav, tmp_path / "b.npz", tiny_bundle, "--runtime", "bare") == 0
    assert read_npz(tmp_path / "b.npz").fps == 30


def test_a_map_of_bones_needs_a_rig(
    wav: Path, tmp_path: Path, tiny_bundle: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(wav, tmp_path / "out.glb", tiny_bundle, "--map", "map.json") == 1
    assert "--map is for a --rig" in capsys.readouterr().err
