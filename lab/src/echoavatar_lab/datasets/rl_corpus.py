"""The sound corpus for tuning a generator by reward (paper, RL Alignment Corpus).

About an hour of spoken conversation and 100 pieces of music: the user's folder, or pieces composed by rule in every
style in turn (the paper uses compositions of many tempos and genres from open platforms). Each recording follows from
the seed and its own name. It is written before the manifest lists it and kept by the next call, so an interrupted run
can continue.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from itertools import count, islice
from pathlib import Path
from typing import Any, Literal, NamedTuple
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from echoavatar.errors import AudioError, EchoAvatarError
from echoavatar.models.audio.files import SOUND_SUFFIXES
from echoavatar.models.audio.io import stream_audio, write_wav
from echoavatar.timing import SAMPLE_RATE_HZ, SAMPLES_PER_FRAME
from echoavatar.whole_file import make_output_folder
from echoavatar_lab.corpora.music.instruments import render
from echoavatar_lab.corpora.music.music import compose_piece
from echoavatar_lab.corpora.music.styles import STYLES
from echoavatar_lab.corpora.rehearsal.augment import set_loudness
from echoavatar_lab.corpora.sound import FloatArray, whole_frames
from echoavatar_lab.data.corpus import checksum
from echoavatar_lab.data.sounds import MANIFEST, Sound, SoundSet, runs, save_sounds
from echoavatar_lab.held_folder import hold_folder

from .conversations import OWN, RULE, Script, conversations, split_of
from .prepare_recording import sound_labels
from .source import files_below
from .text_to_speech import LOUDNESS_DB, TextToSpeech

COMPOSED_SECONDS = (60.0, 120.0)
LONGEST_SECONDS = 600.0  # used of a file
SHORTEST_SECONDS = 4.0


class LabelledSound(NamedTuple):
    """A finished recording with its labels."""

    audio: FloatArray  # (800 t,) at 24 kHz
    domain: NDArray[np.uint8]  # (t,) 0 silence, 1 speech, 2 music
    events: dict[str, tuple[float, ...]]
    source: str
    licence: str
    notes: dict[str, str]


class Job(NamedTuple):
    """A recording to make; `make` raises AudioError if it cannot be made."""

    name: str
    split: Literal["train", "test"]
    make: Callable[[], LabelledSound]


def recorded_music(folder: Path, licence: str) -> Iterator[Job]:
    """One job per sound file of a folder, sorted by path. Raises EchoAvatarError if the folder holds no sound."""
    paths = files_below(folder, *SOUND_SUFFIXES)
    if not paths:
        raise EchoAvatarError(f"--music {folder} holds no sound ({', '.join(SOUND_SUFFIXES)}); name another folder")
    for number, path in enumerate(paths):
        where = path.relative_to(folder)
        stem = "".join(sign if sign.isascii() and sign.isalnum() else "-" for sign in path.stem)[:40]
        name = f"music-{crc32(str(where).encode()):08x}-{stem}"
        yield Job(name, split_of(number), partial(_read_piece, path, str(where), licence))


def composed_music(seed: int) -> Iterator[Job]:
    """Endless composed pieces; each follows from the seed and its number."""
    for number in count():
        yield Job(f"music-own-{seed}-{number:04d}", split_of(number), partial(_compose, seed, number))


def _read_piece(path: Path, where: str, licence: str) -> LabelledSound:
    parts: list[FloatArray] = []
    samples, notes = 0, {}
    for part in stream_audio(path):
        parts.append(part)
        samples += len(part)
        if samples >= LONGEST_SECONDS * SAMPLE_RATE_HZ:
            notes["cut"] = f"after {samples / SAMPLE_RATE_HZ:.0f} s"
            break
    if samples < SHORTEST_SECONDS * SAMPLE_RATE_HZ:
        raise AudioError(f"{where} is shorter than {SHORTEST_SECONDS:.0f} s; choose longer pieces")
    audio = whole_frames(set_loudness(np.concatenate(parts), LOUDNESS_DB))
    domain, events = sound_labels(audio, "music")
    if not domain.any():
        raise AudioError(f"{where} is silent; choose another piece")
    return LabelledSound(audio, domain, events, f"{where}, SHA-256 {checksum(path)}", licence, notes)


def _compose(seed: int, number: int) -> LabelledSound:
    """Compose a piece; its beats are known exactly."""
    rng = np.random.default_rng([seed, 0x3C5, number])
    piece = compose_piece(rng, float(rng.uniform(*COMPOSED_SECONDS)), list(STYLES)[number % len(STYLES)])
    audio = whole_frames(set_loudness(render(piece, rng), LOUDNESS_DB))
    end = len(audio) / SAMPLE_RATE_HZ
    events = {
        kind: tuple(round(float(time), 4) for time in times if 0 <= time < end)
        for kind, times in (("beats", piece.beats), ("downbeats", piece.downbeats))
    }
    domain = np.full(len(audio) // SAMPLES_PER_FRAME, 2, np.uint8)
    notes = {"style": piece.style, "bpm": f"{piece.bpm:.1f}"}
    return LabelledSound(audio, domain, events, "composed by rule", "Apache-2.0", notes)


Kind = Literal["speech", "music"]
Progress = Callable[[Kind, float, float], None]
FAILURES_IN_A_ROW = 5  # after which the scripts are not to blame, so the run stops


@dataclass(frozen=True)
class SoundPlan:
    """The sounds to make, and their folder."""

    folder: Path
    voice: TextToSpeech
    hours: float = 1.0
    pieces: int = 100
    seed: int = 0
    scripts: Path | None = None
    scripts_licence: str = "not stated"
    music: Path | None = None
    music_licence: str = "not stated"

    def info(self) -> dict[str, Any]:
        """The options that must stay the same over all runs on a folder."""
        return {
            "kind": "sound to tune a generator on by reward",
            "seed": self.seed,
            "voice": self.voice.title,
            "scripts": self.scripts.name if self.scripts else "own",
            "music": self.music.name if self.music else "composed by rule",
        }


@dataclass
class RlCorpusResult:
    """The sounds that a run made or kept from earlier runs, and those that it could not make, with the reason."""

    made: dict[str, Sound] = field(default_factory=dict)
    kept: dict[str, Sound] = field(default_factory=dict)
    failures: list[tuple[str, str]] = field(default_factory=list)

    def sounds(self, kind: Kind) -> list[Sound]:
        """Sounds of one kind, made or kept."""
        return [sound for sound in (self.made | self.kept).values() if sound.kind == kind]

    def seconds(self, kind: Kind) -> float:
        """Total length of the sounds of one kind."""
        return sum(sound.seconds for sound in self.sounds(kind))


def make_rl_corpus(plan: SoundPlan, progress: Progress | None = None) -> RlCorpusResult:
    """Make or complete the corpus; progress is in minutes of speech and in pieces of music.

    Raises:
        EchoAvatarError: the plan is empty, a folder cannot be used, or several scripts in a row fail.
        DependencyError: the voice cannot be reached or refuses the key.
    """
    if plan.hours < 0 or plan.pieces < 0 or plan.hours + plan.pieces == 0:
        raise EchoAvatarError(f"--hours {plan.hours:g} and --pieces {plan.pieces} ask for nothing; make one positive")
    pieces = recorded_music(plan.music, plan.music_licence) if plan.music else composed_music(plan.seed)
    music = list(islice(pieces, plan.pieces))  # an empty folder must fail before the speech is made
    with hold_folder(plan.folder):
        folder, found = _CorpusFolder(plan), RlCorpusResult()
        in_a_row, jobs = 0, _speech(plan)
        while found.seconds("speech") < plan.hours * 3600:
            in_a_row = 0 if folder.make_or_keep(next(jobs), "speech", found) else in_a_row + 1
            if in_a_row == FAILURES_IN_A_ROW:
                name, why = found.failures[-1]
                raise EchoAvatarError(f"{in_a_row} scripts in a row failed, the last of them {name}: {why}")
            if progress:
                progress("speech", found.seconds("speech") / 60, plan.hours * 60)
        for number, job in enumerate(music, start=1):
            folder.make_or_keep(job, "music", found)
            if progress:
                progress("music", number, len(music))
        return found


def _speech(plan: SoundPlan) -> Iterator[Job]:
    for script in conversations(plan.seed, plan.scripts):
        yield Job(f"speech-{script.name}", script.split, partial(_spoken, plan, script))


def _spoken(plan: SoundPlan, script: Script) -> LabelledSound:
    said = plan.voice.read(script, np.random.default_rng([plan.seed, crc32(script.name.encode())]))
    text = "Apache-2.0" if script.source in (OWN, RULE) else plan.scripts_licence
    return LabelledSound(
        said.audio,
        said.domain,
        {kind: times for kind, times in said.events.items() if times},
        f"text: {script.source}; spoken by {plan.voice.title} ({', '.join(said.voices)})",
        f"text: {text}; {plan.voice.licence}",
        {"text": "\n".join(turn.text for turn in script.turns)},
    )


class _CorpusFolder:
    """The corpus on disk; recordings of earlier runs stay listed."""

    def __init__(self, plan: SoundPlan) -> None:
        self._folder, self._info = plan.folder, plan.info()
        self._listed: dict[str, Sound] = {}
        for kind in ("speech", "music"):
            make_output_folder(plan.folder / kind)
        if not (plan.folder / MANIFEST).exists():
            return
        before = SoundSet(plan.folder)
        for key, now in self._info.items():
            if before.info.get(key) != now:
                raise EchoAvatarError(
                    f"{plan.folder} was made with {key} {before.info.get(key)!r}, this call says {now!r}; use the same"
                    " options or choose another -o"
                )
        self._listed = {sound.name: sound for sound in before.sounds if before.is_intact(sound)}

    def make_or_keep(self, job: Job, kind: Kind, found: RlCorpusResult) -> bool:
        """Make a recording unless it exists; note a failure and return False."""
        if job.name in self._listed:
            found.kept[job.name] = self._listed[job.name]
            return True
        try:
            sound = self._write(job, kind, job.make())
        except AudioError as error:
            found.failures.append((job.name, str(error)))
            return False
        found.made[job.name] = self._listed[job.name] = sound
        save_sounds(self._folder, self._listed.values(), self._info)
        return True

    def _write(self, job: Job, kind: Kind, take: LabelledSound) -> Sound:
        file = f"{kind}/{job.name}.wav"
        write_wav(self._folder / file, take.audio)
        return Sound(
            name=job.name,
            file=file,
            kind=kind,
            split=job.split,
            frames=len(take.audio) // SAMPLES_PER_FRAME,
            sha256=checksum(self._folder / file),
            source=take.source,
            licence=take.licence,
            heard=runs(take.domain),
            events=take.events,
            notes=take.notes,
        )
