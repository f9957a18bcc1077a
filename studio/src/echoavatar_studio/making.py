"""Making a study from its settings: sounds, clips and tasks, in the background or from the command line."""

import logging
import shutil
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import yaml
from jaxtyping import Float
from sqlalchemy import select
from sqlalchemy.orm import Session

from echoavatar.engine.pipeline import Pipeline, load_bundle
from echoavatar.errors import AudioError, EchoAvatarError
from echoavatar.timing import CHUNK_SAMPLES, CHUNK_SECONDS, SAMPLE_RATE_HZ

from .audit import note
from .candidates import candidates, starts, token_file, token_name
from .clips import Performance, Progress, corrupt, fit, save_clip, save_sound, without_face
from .errors import RETRY_S, StoreAwayError
from .planning import Item, plan
from .secrecy import new_name
from .settings import PairwiseStudy, PreferenceStudy, SystemChoice
from .sources import SoundCut, perform, read_sounds
from .store import Store
from .tables import Clip, Sound, Study, System
from .wire_owner import Making

_LOG = logging.getLogger(__name__)


def _quiet(done: int, of: int, what: str) -> None:
    del done, of, what


@dataclass(frozen=True)
class Material:
    """A sound with its clips, on disk but not yet in the store."""

    name: str
    category: str
    sound: str
    seconds: float
    clips: tuple[tuple[str, str, int | None, list[list[list[int]]] | None], ...]  # system or number, file, seed, codes
    corrupted: str
    prompt: dict[str, object] | None = None


class Maker:
    """Makes studies in a store and its media folder; `making` has the progress of those under way."""

    def __init__(self, store: Store, media: Path) -> None:
        self.store, self.media = store, media
        self.making: dict[str, Making] = {}
        self._one_at_a_time = threading.Lock()

    def known(self, settings: PairwiseStudy | PreferenceStudy) -> str | None:
        """The study with exactly these settings, or None. A studio that is restarted does not make it again."""
        wanted = select(Study.public).where(Study.settings == _text(settings), Study.state != "failed")
        with self.store.read() as session:
            return session.scalar(wanted.limit(1))

    def begin(self, settings: PairwiseStudy | PreferenceStudy, *, by: str) -> str:
        """Create a study without clips; return its public name."""
        with self.store.write() as session:
            study = Study(
                public=new_name(),
                kind=settings.kind,
                title=settings.title,
                state="making",
                settings=_text(settings),
                created=time.time(),
            )
            session.add(study)
            note(session, by, "study begun", study=study.public, detail=settings.title)
            return study.public

    def make(
        self, public: str, settings: PairwiseStudy | PreferenceStudy, base: Path, *, progress: Progress = _quiet
    ) -> None:
        """Make the clips and tasks of a study, and open it.

        Raises:
            EchoAvatarError: a sound, model or clip cannot be used; the study is marked as failed with the reason.
        """
        folder = self.media / public

        def tell(done: int, of: int, what: str) -> None:
            self.making[public] = Making(done=done, of=of, what=what)
            progress(done, of, what)

        try:
            with self._one_at_a_time:
                tell(0, 1, "reading sounds")
                if settings.kind == "pairwise":
                    rows = make_pairwise(settings, base, folder, tell)
                else:
                    rows = make_preference(settings, base, folder, tell)
            self._keep(public, lambda session: self.write(session, public, settings, rows))
        except Exception as error:
            why = str(error) if isinstance(error, EchoAvatarError) else "an error of the studio; see the server's log"
            self._fail(public, why)
            raise
        finally:
            self.making.pop(public, None)

    def make_later(self, public: str, settings: PairwiseStudy | PreferenceStudy, base: Path) -> threading.Thread:
        """Run `make` in a thread; an error is stored with the study."""

        def work() -> None:
            try:
                self.make(public, settings, base)
            except EchoAvatarError as error:
                _LOG.warning("study %s: %s", public, error)
            except Exception:
                _LOG.exception("study %s could not be made", public)

        thread = threading.Thread(target=work, name=f"making {public}", daemon=True)
        thread.start()
        return thread

    def _fail(self, public: str, why: str) -> None:
        shutil.rmtree(self.media / public, ignore_errors=True)

        def mark(session: Session) -> None:
            study = _study(session, public)
            study.state, study.problem = "failed", why
            note(session, "studio", "study failed", study=public, detail=why)

        self._keep(public, mark)

    def _keep(self, public: str, change: Callable[[Session], None]) -> None:
        """Write how the making ended; while the store is away, wait for it, so that no made clip is lost."""
        has_told = False
        while True:
            try:
                with self.store.write() as session:
                    if _study(session, public).state == "making":  # otherwise an earlier try reached the disk after all
                        change(session)
                    return
            except StoreAwayError as away:
                if not has_told:
                    _LOG.warning("study %s is made and waits for the store: %s", public, away.reason)
                has_told = True
                time.sleep(RETRY_S)

    def write(
        self, session: Session, public: str, settings: PairwiseStudy | PreferenceStudy, rows: Sequence[Material]
    ) -> None:
        """Register the files on disk in the store, plan the tasks, and open the study."""
        study = _study(session, public)
        systems: dict[str, int] = {}
        for place, choice in enumerate(_systems(settings)):
            system = System(study_id=study.id, name=choice.name, source=_source(choice), place=place)
            session.add(system)
            session.flush()
            systems[choice.name] = system.id
        items = [self._item(session, study, public, row, systems) for row in rows]
        count = plan(session, study, settings, items)
        study.state = "open"
        note(session, "studio", "study opened", study=public, detail=f"{len(rows)} sounds, {count} judgements wanted")

    def _item(self, session: Session, study: Study, public: str, row: Material, systems: dict[str, int]) -> Item:
        sound = Sound(
            study_id=study.id,
            name=row.name,
            category=row.category,
            path=f"{public}/{row.sound}",
            seconds=row.seconds,
            prompt=row.prompt,
        )
        session.add(sound)
        session.flush()
        whole: dict[str, Clip] = {}
        for number, (key, file, seed, codes) in enumerate(row.clips):
            whole[key] = Clip(
                study_id=study.id,
                sound_id=sound.id,
                system_id=systems.get(key, next(iter(systems.values()))),
                candidate=number if codes is not None else 0,
                path=f"{public}/{file}",
                seed=seed,
                codes=codes,
            )
        corrupted = Clip(study_id=study.id, sound_id=sound.id, system_id=None, path=f"{public}/{row.corrupted}")
        session.add_all([*whole.values(), corrupted])
        session.flush()
        return Item(sound.id, row.name, {key: clip.id for key, clip in whole.items()}, corrupted.id)


def make_pairwise(settings: PairwiseStudy, base: Path, folder: Path, progress: Progress) -> list[Material]:
    """Make the clips of every system for every sound, system by system, so that only one model is in memory.

    If a system has no face, or its motion belongs to another sound, all faces of the study are neutral, so that no face
    gives a system away. A muted study has silence for sound.
    """
    cuts = read_sounds(settings.sounds, base, seconds=settings.seconds)
    total, done = len(cuts) * len(settings.systems), 0
    clips: dict[int, list[tuple[str, str, int | None, None]]] = {number: [] for number in range(len(cuts))}
    corrupted: dict[int, Performance] = {}
    places = {system.name: place for place, system in enumerate(settings.systems)}
    is_neutral = any(system.mismatched for system in settings.systems)
    for place, system in enumerate(settings.systems):
        if system.mismatched is not None:
            continue
        performer = perform(system, base)
        for number, cut in enumerate(cuts):
            progress(done, total, f"{system.name}: {cut.name}")
            shown, seed = performer(cut, number)
            is_neutral = is_neutral or shown.face is None
            file = _file(number, place)
            save_clip(folder / file, shown)
            clips[number].append((system.name, file, seed, None))
            if number not in corrupted:
                corrupted[number] = corrupt(shown, number)
            done += 1
    for place, system in enumerate(settings.systems):
        if system.mismatched is not None:
            for number, other in enumerate(others_of_category(cuts)):
                shutil.copyfile(folder / _file(other, places[system.mismatched]), folder / _file(number, place))
                clips[number].append((system.name, _file(number, place), None, None))
    if is_neutral:
        for _, file, _, _ in (one for own in clips.values() for one in own):
            without_face(folder / file)
        corrupted = {number: shown._replace(face=None) for number, shown in corrupted.items()}
    progress(total, total, "planning")
    silence = 0.0 if settings.muted else 1.0
    return [
        _stored(folder, number, cut, cut.audio * silence, tuple(clips[number]), corrupted[number])
        for number, cut in enumerate(cuts)
    ]


def others_of_category(cuts: Sequence[SoundCut]) -> list[int]:
    """For each sound the number of the next one of its category, the last one's being the first.

    Raises:
        AudioError: a category has one sound, to which nothing can be mismatched.
    """
    found = []
    for number, cut in enumerate(cuts):
        own = [at for at, other in enumerate(cuts) if other.category == cut.category]
        if len(own) < 2:
            raise AudioError(f"{cut.name} is the only sound of {cut.category}; mismatched motion needs another one")
        found.append(own[(own.index(number) + 1) % len(own)])
    return found


def _file(number: int, place: int) -> str:
    return f"{number:03d}-{place:02d}.motion"


def make_preference(settings: PreferenceStudy, base: Path, folder: Path, progress: Progress) -> list[Material]:
    """Make the candidates for every prompt, and the token files that `align dpo` reads."""
    cuts = read_sounds(settings.sounds, base, seconds=None)
    inside = base / settings.model
    bundle = load_bundle(inside if (inside / "generator").is_dir() else settings.model)
    pipeline = Pipeline(bundle)
    rows: list[Material] = []
    progress(0, len(cuts), "loading the model")
    pipeline.warm_up()
    for number, cut in enumerate(cuts):
        progress(number, len(cuts), cut.name)
        clip = token_file(folder / "tokens", bundle, cut, settings.seed)
        for start in starts(clip, settings, cut.name):
            made = candidates(pipeline, bundle, cut, clip, start, settings)
            files = []
            for at, one in enumerate(made):
                file = _file(len(rows), at)
                save_clip(folder / file, one.shown)
                files.append((f"candidate {at + 1}", file, one.seed, one.codes))
            begin = start + settings.past
            audio = fit(cut.audio[begin * CHUNK_SAMPLES :], made[0].shown.motion.frames)
            row = _stored(folder, len(rows), cut, audio, tuple(files), corrupt(made[-1].shown, number))
            second = begin * CHUNK_SECONDS
            prompt = {"clip": token_name(cut), "start": start, "past": settings.past, "second": second}
            rows.append(replace(row, name=f"{row.name} @{second:.1f}s", prompt=prompt))
    progress(len(cuts), len(cuts), "planning")
    return rows


def _stored(
    folder: Path,
    number: int,
    cut: SoundCut,
    audio: Float[np.ndarray, " s"],
    clips: tuple[tuple[str, str, int | None, list[list[list[int]]] | None], ...],
    corrupted: Performance,
) -> Material:
    sound, bad = f"{number:03d}.flac", f"{number:03d}-x.motion"
    save_sound(folder / sound, audio)
    save_clip(folder / bad, corrupted)
    return Material(cut.name, cut.category, sound, len(audio) / SAMPLE_RATE_HZ, clips, bad)


def _text(settings: PairwiseStudy | PreferenceStudy) -> str:
    text: str = yaml.safe_dump(settings.model_dump(mode="json"), sort_keys=False, allow_unicode=True)
    return text


def _systems(settings: PairwiseStudy | PreferenceStudy) -> Sequence[SystemChoice]:
    if settings.kind == "pairwise":
        return settings.systems
    return [SystemChoice(name=Path(settings.model).name[:80], model=settings.model)]


def _source(choice: SystemChoice) -> str:
    return choice.model or choice.clips or f"{choice.mismatched}, to another sound"


def _study(session: Session, public: str) -> Study:
    return session.query(Study).filter(Study.public == public).one()
