"""Two tables of sound, not in the paper: how well recordings are labelled, and what a reader finds in a codec's codes.

`sound-labels` has F-measures at 70 ms against truth that no tracker made: synthetic sound, whose labels are known by
construction and which is treated as a recording is (room, equaliser, noise); and short loops of the recordings
(`--corpus`), which by construction hold a whole number of beats and begin on one. How many beats a loop has was counted
in spectrograms.

`codec`: the generator hears nothing but codes. A small convolutional reader is trained on the codes of known sound, the
same for every codec, and is tested on voices and pieces that neither codec nor reader has met: the dev files of a
folder of recordings (`--corpus`), and synthetic sound of the test split. Truth: labels of synthetic sound; of
recordings those of `recording_labels`, which hear the clean sound. So a number for recordings says how much of what a
tracker hears is left in the codes, not how well the tracker hears.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from scipy.signal import find_peaks
from torch import Tensor, nn

from echoavatar.engine.pipeline import load_bundle
from echoavatar.errors import EchoAvatarError
from echoavatar.models.audio.codec_config import CODE_LAYERS
from echoavatar.timing import SAMPLE_RATE_HZ, SAMPLES_PER_AUDIO_TOKEN
from echoavatar_lab.corpora.music.beat_tracker import onset_strength, track_beats
from echoavatar_lab.corpora.rehearsal.augment import set_loudness
from echoavatar_lab.corpora.rehearsal.recorded_sound import RecordedSound
from echoavatar_lab.corpora.rehearsal.recording_labels import track_from_recording
from echoavatar_lab.corpora.rehearsal.track import compose_track
from echoavatar_lab.corpora.sound import SoundTrack
from echoavatar_lab.models.audio.codec import AudioCodec
from echoavatar_lab.models.audio.mel import log_mel
from echoavatar_lab.models.audio.recordings import decoded, recorded_files
from echoavatar_lab.models.tokenize import audio_codes

from .experiment import Experiment
from .table import Cell, Column, Line, Table

LABELS = "sound-labels"
LABEL_COLUMNS = (Column("f", "F at 70 ms", better="higher"), Column("chance", "F of random times", better=""))
LOOPS = {
    "loop_amen_full": 16, "loop_amen": 4, "loop_breakbeat": 4, "loop_tabla": 16, "loop_safari": 16, "loop_mika": 16,
    "loop_compus": 16, "loop_mehackit1": 4, "loop_mehackit2": 4, "loop_garzul": 16, "loop_perc1": 4, "loop_perc2": 4,
    "loop_industrial": 2, "POL-aquatic-circus-short": 48, "POL-brave-worm-short": 32, "POL-cactus-land-short": 32,
    "POL-chubby-cat-short": 32, "POL-dream-course-short": 32, "POL-sky-sanctuary-short": 32,
    "POL-snowy-hill-short": 32, "POL-treasure-match-short": 32,
}  # fmt: skip
Times = Sequence[float] | np.ndarray


def make_labels(experiment: Experiment) -> Table:
    """Label all sounds and compare the labels with the truth."""
    if experiment.sources.corpus is None:
        raise EchoAvatarError("reproduce sound-labels reads loops: give a folder with a manifest.csv as --corpus")
    count = {"tiny": 2, "rehearsal": 20, "paper": 40}[experiment.scale.name]
    rng = np.random.default_rng(experiment.seed)
    pairs: dict[str, list[tuple[Times, Times]]] = {}
    first = 800_000 + 1000 * experiment.seed
    for seed in range(first, first + count):
        known = compose_track(seed, 30.0, "speech", split="test")
        found = track_from_recording(known.audio, "speech")
        both = (known, found)
        times: dict[str, list[list[float]]] = {
            "syllables": [[s.vowel for s in one.syllables] for one in both],
            "stresses": [one.stresses for one in both],
            "phrases begin": [[begin for begin, _ in one.phrases] for one in both],
            "phrases end": [[end for _, end in one.phrases] for one in both],
        }
        for name, (wanted, given) in times.items():
            pairs.setdefault(f"synthetic speech: {name}", []).append((wanted, given))
        music = compose_track(seed, 30.0, "music", split="test")
        heard = track_from_recording(music.audio, "music")
        pairs.setdefault("synthetic music: beats", []).append((music.beats, heard.beats))
        pairs.setdefault("synthetic music: downbeats", []).append((music.downbeats, heard.downbeats))
    for name, beats, audio, loop_s in _loops(experiment.sources.corpus):
        pairs.setdefault("loops: beats, by ear alone", []).append((beats, track_beats(audio).beats))
        told = track_beats(audio, loop_s=loop_s).beats
        pairs.setdefault("loops: beats, length known", []).append((beats, told))
        experiment.say(f"{name}: {f_measure(beats, told):.2f}")
    lines = [
        Line(
            f"{name} ({len(clips)} clips)",
            {},
            {
                "f": Cell(float(np.mean([f_measure(wanted, given) for wanted, given in clips]))),
                "chance": Cell(float(np.mean([f_measure(wanted, _random(wanted, rng)) for wanted, _ in clips]))),
            },
        )
        for name, clips in pairs.items()
    ]
    notes = ("Mean over clips. With the length known, the beats of a loop are right once their number is.",)
    return Table(LABELS, "Labels of recordings", LABEL_COLUMNS, lines, notes)


def _loops(folder: Path) -> list[tuple[str, np.ndarray, np.ndarray, float]]:
    """Name, beats, sound of at least 24 s, and length of each loop that the folder has."""
    found = []
    for file in recorded_files(folder):
        if file.path.stem in LOOPS:
            once = decoded(file.path).astype(np.float32) / 32_768
            loop_s = len(once) / SAMPLE_RATE_HZ
            times = int(np.ceil(24 / loop_s))
            beats = np.arange(times * LOOPS[file.path.stem]) * loop_s / LOOPS[file.path.stem]
            found.append((file.path.stem, beats, np.tile(once, times), loop_s))
    return found


def _random(wanted: Times, rng: np.random.Generator) -> np.ndarray:
    return rng.uniform(0, max(wanted, default=1.0), len(wanted))


def f_measure(wanted: Times, given: Times) -> float:
    """F-measure of event times in seconds at 70 ms; each event counts once."""
    free = sorted(float(time) for time in given)
    hits = 0
    for time in wanted:
        near = [other for other in free if abs(other - time) <= 0.07]
        if near:
            free.remove(min(near, key=lambda other: abs(other - time)))
            hits += 1
    return 2 * hits / max(1, len(wanted) + len(given))


CODEC = "codec"
CODEC_COLUMNS = (
    Column("domain", "Silence, speech or music: balanced accuracy", better="higher"),
    Column("voiced", "Voiced: balanced accuracy", better="higher"),
    Column("energy", "Loudness: R²", better="higher"),
    Column("onset", "Onset: F at 70 ms", better="higher"),
    Column("stress", "Stress: F at 70 ms", better="higher"),
    Column("beat", "Beat: F at 70 ms", better="higher"),
)
_EVENTS = ("onset", "stress", "beat")
_FRAME_S = SAMPLES_PER_AUDIO_TOKEN / SAMPLE_RATE_HZ
_CROP = 300  # frames, 4 s
_BANDS = 64
_SECONDS = 40.0  # of one sound


class KnownSound(NamedTuple):
    """Sound and the true labels of each of its frames; `events` are marked a frame wide."""

    audio: Float[np.ndarray, " s"]
    domain: Int[np.ndarray, " n"]
    voiced: Float[np.ndarray, " n"]
    energy: Float[np.ndarray, " n"]
    events: Float[np.ndarray, "n 3"]


class Reader(nn.Module):
    """Codes to 3 domains, voiced, energy and three events per frame; sees 0.4 s to either side."""

    def __init__(self, codes: int, width: int = 48) -> None:
        """With 0 `codes` it reads log-mel spectra."""
        super().__init__()
        first = (nn.Embedding(codes, width) for _ in range(CODE_LAYERS)) if codes else [nn.Linear(_BANDS, width)]
        self.tables = nn.ModuleList(first)
        self.body = nn.Sequential()
        for dilation in (1, 2, 4, 8):
            self.body.append(nn.Conv1d(width, width, 5, padding=2 * dilation, dilation=dilation))
            self.body.append(nn.ELU())
        self.head = nn.Conv1d(2 * width, 8, 1)

    def forward(self, heard: Tensor) -> Float[Tensor, "b n c"]:
        """Codes (b, n, 2) or spectra (b, n, 64) to (b, n, 8)."""
        if heard.is_floating_point():
            x = self.tables[0](heard).transpose(1, 2)
        else:
            x = torch.stack([table(heard[..., q]) for q, table in enumerate(self.tables)]).sum(0).transpose(1, 2)
        out: Tensor = self.head(torch.cat([x, self.body(x)], 1)).transpose(1, 2)
        return out


def make_codec(experiment: Experiment) -> Table:
    """Train a reader on each codec's codes and test it."""
    folder, given = experiment.sources.corpus, experiment.sources.codec
    if folder is None:
        raise EchoAvatarError("reproduce codec tests on recordings: give a folder with a manifest.csv as --corpus")
    count = {"tiny": 2, "rehearsal": 60, "paper": 200}[experiment.scale.name]
    seed = experiment.seed
    training = [*recorded(folder, "train", count, seed), *synthetic("train", count, seed)]
    tests = {
        "recorded": recorded(folder, "dev", max(2, count // 3), seed),
        "synthetic": synthetic("test", max(2, count // 3), seed),
    }
    codecs: dict[str, AudioCodec | None] = {"default bundle": load_bundle("default").codec}
    codecs |= {given.name: AudioCodec.load(given).eval()} if given else {}
    codecs |= {"log-mel, no codec": None}
    lines = []
    for name, codec in codecs.items():
        experiment.say(f"codes of {name}")
        reader, ends = train_reader(codec, training, steps=30 * count, seed=seed)
        for kind, sounds in tests.items():
            found = score(codec, reader, ends, sounds)
            lines.append(Line(f"{name}: {kind}", {}, {key: Cell(value) for key, value in found.items()}))
    for kind, sounds in tests.items():
        lines.append(Line(f"chance: {kind}", {}, {key: Cell(value) for key, value in chance(sounds, seed).items()}))
    notes = (
        f"Readers: {len(training)} sounds of {_SECONDS:.0f} s, {30 * count} steps; tests:"
        f" {len(tests['recorded'])} recorded and {len(tests['synthetic'])} synthetic sounds.",
        "Chance: as many events at random times; for the rest a constant answer.",
        "Log-mel: what the same reader finds in 64 bands, so what the codes lose.",
        "Recordings: the truth is what trackers hear in the clean sound.",
    )
    return Table(CODEC, "What a reader finds in the codes", CODEC_COLUMNS, lines, notes)


def recorded(folder: Path, split: str, count: int, seed: int) -> list[KnownSound]:
    """Speech and music in turn, from the recordings of a split."""
    source, rng = RecordedSound(folder, split), np.random.default_rng([seed, split != "train"])
    drawn = [(source.speech if i % 2 == 0 else source.music)(rng, _SECONDS) for i in range(count)]
    return [known(track) for track in drawn]


def synthetic(split: str, count: int, seed: int) -> list[KnownSound]:
    """Synthetic sound with its true labels."""
    first = 700_000 + 1000 * seed
    return [known(compose_track(first + i, _SECONDS, split=split)) for i in range(count)]


def known(track: SoundTrack) -> KnownSound:
    """A track with its true labels, at one loudness, as the level control makes all sound alike."""
    frames = len(track.audio) // SAMPLES_PER_AUDIO_TOKEN
    audio = set_loudness(track.audio[: frames * SAMPLES_PER_AUDIO_TOKEN], -25)
    domain = np.zeros(frames, np.int64)
    for span in track.spans:
        kind = {"silence": 0, "speech": 1, "music": 2}[span.kind]
        domain[round(span.start / _FRAME_S) : round(span.end / _FRAME_S)] = kind
    power = np.mean(audio.reshape(frames, -1).astype(np.float64) ** 2, axis=1)
    strength = onset_strength(audio).full
    onsets = find_peaks(strength, height=1.5, distance=6)[0] * 0.01
    events = np.stack([_marked(times, frames) for times in (onsets, track.stresses, track.beats)], axis=1)
    return KnownSound(audio, domain, _voiced(audio, frames), 10 * np.log10(power + 1e-6), events)


def _marked(times: Sequence[float] | np.ndarray, frames: int) -> np.ndarray:
    marked = np.zeros(frames, np.float32)
    marked[np.clip((np.asarray(times) / _FRAME_S).astype(int), 0, frames - 1)] = 1
    return marked


def _voiced(audio: np.ndarray, frames: int) -> np.ndarray:
    """1 where the autocorrelation of 50 ms has a peak above 0.5 between 70 and 400 Hz and there is sound."""
    size = 1200
    padded = np.pad(audio, (size // 2, size // 2)).astype(np.float32)
    windows = np.lib.stride_tricks.sliding_window_view(padded, size)[SAMPLES_PER_AUDIO_TOKEN // 2 :: 320][:frames]
    voiced = np.zeros(frames, np.float32)
    taper = 1 - np.arange(size) / size
    for first in range(0, len(windows), 512):
        part = windows[first : first + 512]
        power = np.abs(np.fft.rfft(part - part.mean(1, keepdims=True), 4096)) ** 2
        lags = np.fft.irfft(power)[:, :size] / taper.clip(0.3)
        peak = lags[:, SAMPLE_RATE_HZ // 400 : SAMPLE_RATE_HZ // 70].max(1)
        voiced[first : first + len(part)] = (peak > 0.5 * lags[:, 0]) & (part.std(1) > 3e-3)
    return voiced


@torch.inference_mode()
def heard(codec: AudioCodec | None, audio: np.ndarray) -> Tensor:
    """Codes (n, 2) of sound, or without a codec its log-mel spectrum (n, 64)."""
    if codec is not None:
        return torch.from_numpy(audio_codes(codec, audio)).long()
    spectrum = log_mel(torch.from_numpy(audio[None].copy()), fft=1024, hop=SAMPLES_PER_AUDIO_TOKEN, bands=_BANDS)
    return spectrum[0, : len(audio) // SAMPLES_PER_AUDIO_TOKEN].clone() / 4 + 1


def train_reader(
    codec: AudioCodec | None, sounds: Sequence[KnownSound], *, steps: int, seed: int
) -> tuple[Reader, dict[str, float]]:
    """A reader of a codec's codes, and the threshold of each event that is best on the training sound."""
    torch.manual_seed(seed)
    reader = Reader(codec.config.codes if codec else 0)
    optimiser = torch.optim.AdamW(reader.parameters(), lr=3e-3, weight_decay=1e-2)
    codes = [heard(codec, sound.audio) for sound in sounds]
    mean, sd = (float(f(np.concatenate([sound.energy for sound in sounds]))) for f in (np.mean, np.std))
    rng = np.random.default_rng(seed)
    for step in range(steps):
        for group in optimiser.param_groups:
            group["lr"] = 3e-3 * (0.02 + 0.98 * (1 - step / steps))
        drawn = [int(i) for i in rng.integers(0, len(sounds), 12)]
        starts = [int(rng.integers(0, max(1, len(codes[i]) - _CROP))) for i in drawn]
        places = [slice(start, start + _CROP) for start in starts]
        out = reader(torch.stack([codes[i][at] for i, at in zip(drawn, places, strict=True)]))
        domain, voiced, energy, events = (
            torch.from_numpy(np.stack([np.asarray(sounds[i][part])[at] for i, at in zip(drawn, places, strict=True)]))
            for part in (1, 2, 3, 4)
        )
        spread = F.max_pool1d(events.float().transpose(1, 2), 3, stride=1, padding=1).transpose(1, 2)
        loss = F.cross_entropy(out[..., :3].flatten(0, 1), domain.flatten())
        loss = loss + F.binary_cross_entropy_with_logits(out[..., 3], voiced.float())
        loss = loss + F.mse_loss(out[..., 4], ((energy - mean) / sd).float())
        loss = loss + F.binary_cross_entropy_with_logits(out[..., 5:], spread, pos_weight=torch.tensor(3.0))
        optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        optimiser.step()
    reader.eval()
    ends = {"mean": mean, "sd": sd}
    said = [_read(codec, reader, sound) for sound in sounds[:: max(1, len(sounds) // 24)]]
    for k, name in enumerate(_EVENTS):
        tried = {
            limit: _f_measure([(out[:, 5 + k], sound.events[:, k]) for out, sound in said], limit)
            for limit in (0.2, 0.3, 0.4, 0.5, 0.6, 0.7)
        }
        ends[name] = max(tried, key=lambda limit: tried[limit])
    return reader, ends


@torch.inference_mode()
def _read(codec: AudioCodec | None, reader: Reader, sound: KnownSound) -> tuple[np.ndarray, KnownSound]:
    out = reader(heard(codec, sound.audio)[None])[0]
    out[:, 5:] = out[:, 5:].sigmoid()
    return out.numpy(), sound


def score(
    codec: AudioCodec | None, reader: Reader, ends: dict[str, float], sounds: Sequence[KnownSound]
) -> dict[str, float]:
    """The columns of the table for some sounds."""
    said = [_read(codec, reader, sound) for sound in sounds]
    out = np.concatenate([one for one, _ in said])
    domain, voiced, energy = (np.concatenate([np.asarray(sound[part]) for _, sound in said]) for part in (1, 2, 3))
    speech = domain == 1
    guess = out[:, 4] * ends["sd"] + ends["mean"]
    found = {
        "domain": _balanced(out[:, :3].argmax(1), domain),
        "voiced": _balanced((out[speech, 3] > 0).astype(int), voiced[speech].astype(int)),
        "energy": float(1 - np.mean((guess - energy) ** 2) / np.var(energy)),
    }
    for k, name in enumerate(_EVENTS):
        found[name] = _f_measure([(one[:, 5 + k], sound.events[:, k]) for one, sound in said], ends[name])
    return found


def chance(sounds: Sequence[KnownSound], seed: int) -> dict[str, float]:
    """Scores of answers that do not depend on the sound."""
    rng = np.random.default_rng(seed)
    kinds = len(np.unique(np.concatenate([sound.domain for sound in sounds])))
    found = {"domain": 1 / kinds, "voiced": 0.5, "energy": 0.0}
    for k, name in enumerate(_EVENTS):
        pairs = [(rng.permutation(sound.events[:, k]), sound.events[:, k]) for sound in sounds]
        found[name] = _f_measure(pairs, 0.5)
    return found


def _balanced(guess: np.ndarray, true: np.ndarray) -> float:
    """Mean over the classes of the share that is found."""
    return float(np.mean([np.mean(guess[true == kind] == kind) for kind in np.unique(true)]))


def _f_measure(pairs: Sequence[tuple[np.ndarray, np.ndarray]], limit: float) -> float:
    """Mean over sounds of the F-measure of peaks above a limit; a sound without such events does not count."""
    scores = []
    for strength, marks in pairs:
        if marks.any():
            given = (find_peaks(np.pad(strength, 1), height=limit, distance=6)[0] - 1) * _FRAME_S
            scores.append(f_measure(np.flatnonzero(marks) * _FRAME_S, given))
    return float(np.mean(scores)) if scores else 0.0
