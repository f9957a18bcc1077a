"""`study.yaml`, the settings of a study (paper, Subjective Evaluation Protocol, Direct Preference Alignment)."""

from functools import lru_cache
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, TypeAdapter, ValidationError, model_validator

from echoavatar.config import Config
from echoavatar.errors import EchoAvatarError
from echoavatar.limits import read_text
from echoavatar.timing import CHUNK_SECONDS
from echoavatar.yaml_reader import YAML_BYTES, read_yaml

from .wire import MAX_CLIPS, QUESTIONS, Category, Presentation, Question

CONSENT = (
    "You will watch short animations with sound and say what you think of them. We keep your answers and the times"
    " at which you gave them, under a number; no name, no address. You may stop at any moment, and you may delete"
    " everything you gave on the page itself. The answers are used for research and may be published in a form that"
    " tells nothing of single persons."
)
INTRO = "Please use headphones or loudspeakers, and watch every clip to its end before you answer."


LARGEST_SEED = (1 << 31) - 1
LANGUAGE = "[a-z]{2}(-[A-Z]{2})?"  # such as de or pt-BR


class SoundChoice(Config):
    """A sound file, or a folder of them."""

    path: str = Field(description="file or folder, relative to study.yaml")
    category: Category = Field(description="dance: music; gesture: speech")
    start: float = Field(default=0.0, ge=0, le=86_400, description="seconds at which the clip begins")


class SystemChoice(Config):
    """A system that is compared: a model that makes its clips, a folder that holds them, or a mismatch of another."""

    name: str = Field(min_length=1, max_length=80, description="its name in the table")
    model: str | None = Field(default=None, description="name or folder of a bundle")
    clips: str | None = Field(default=None, description="folder of .npz or .bvh motion named after the sound files")
    mismatched: str | None = Field(
        default=None, description="name of the system whose motion to another sound of the category is shown (GENEA)"
    )
    seed: int = Field(default=0, ge=0, le=LARGEST_SEED, description="seed of the model")
    group: str = Field(
        default="", max_length=80, description="heading of the table's rows; only systems of one group are compared"
    )

    @model_validator(mode="after")
    def _has_one_source(self) -> Self:
        if sum(source is not None for source in (self.model, self.clips, self.mismatched)) != 1:
            raise ValueError(f"system {self.name!r} needs one of model, clips (a folder) and mismatched (a system)")
        return self


class Checks(Config):
    """Attention checks among each rater's tasks."""

    identical: int = Field(default=1, ge=0, le=10, description="pairwise: checks with the same clip twice")
    corrupted: int = Field(default=1, ge=0, le=10, description="checks with a plainly broken clip")


class _Study(Config):
    title: str = Field(min_length=1, max_length=200)
    language: str = Field(default="en", pattern=f"^{LANGUAGE}$", description="language of the raters' page")
    intro: str = Field(default=INTRO, max_length=4000)
    consent: str = Field(default=CONSENT, min_length=1, max_length=8000)
    sounds: tuple[SoundChoice, ...] = Field(min_length=1)
    raters: int = Field(ge=1, le=2000, description="raters wanted")
    tasks_per_rater: int = Field(default=20, ge=1, le=500, description="tasks that count; at most all there are")
    training: int = Field(default=1, ge=0, le=10, description="practice tasks before the first")
    checks: Checks = Checks()
    min_plays: int = Field(default=1, ge=0, le=10, description="times that each clip must be played")
    seed: int = Field(default=0, ge=0, le=LARGEST_SEED, description="seed of the design")


class PairwiseStudy(_Study):
    """Two systems on the same sound."""

    kind: Literal["pairwise"]
    systems: tuple[SystemChoice, ...] = Field(min_length=2, max_length=20)
    seconds: float = Field(default=10.0, ge=1, le=60, description="length of a clip")
    presentation: Presentation = "sequential"
    questions: tuple[Question, ...] = Field(default=QUESTIONS, min_length=1)
    muted: bool = Field(default=False, description="raters hear nothing, as when realism alone is asked (GENEA)")

    @model_validator(mode="after")
    def _names_are_one_each(self) -> Self:
        names = [system.name for system in self.systems]
        if len(set(names)) < len(names):
            raise ValueError("two systems have the same name")
        if len(set(self.questions)) < len(self.questions):
            raise ValueError("a question is asked twice")
        groups = [system.group for system in self.systems]
        if self.muted and "beat_matching" in self.questions:
            raise ValueError("a muted study cannot ask beat_matching; name the questions without it")
        made = {system.name: system.group for system in self.systems if system.mismatched is None}
        for system in self.systems:
            if system.mismatched is not None and made.get(system.mismatched) != system.group:
                raise ValueError(
                    f"system {system.name!r}: mismatched is {system.mismatched!r}, which must be a system of its own"
                    " group with a model or a folder"
                )
        if lone := [group for group in groups if groups.count(group) == 1]:
            raise ValueError(f"group {lone[0]!r} has one system; a group needs at least two")
        return self


class Keeping(Config):
    """Which pairs are exported ("pairs lacking a distinct quality disparity are filtered out")."""

    votes: int = Field(default=1, ge=1, description="least answers per sound, skips included")
    agreement: float = Field(
        default=0.6, ge=0, le=1, description="least share in favour, among answers that concern the pair"
    )
    margin: float = Field(
        default=0.3, ge=0, le=1, description="least difference of answers in favour and against, as a share of all"
    )


class PreferenceStudy(_Study):
    """N candidates of one model for the same sound."""

    kind: Literal["preference"]
    model: str = Field(default="default", description="name or folder of a bundle")
    candidates: int = Field(default=8, ge=2, le=MAX_CLIPS - 1)
    past: int = Field(default=3, ge=0, le=40, description="chunks of motion before the candidates begin to differ")
    length: int = Field(default=20, ge=1, le=80, description=f"chunks of a candidate, {CHUNK_SECONDS:.3f} s each")
    prompts_per_sound: int = Field(
        default=1, ge=1, le=50, description="stretches of each sound that are used, evenly spread"
    )
    keep: Keeping = Keeping()


StudySettings = Annotated[PairwiseStudy | PreferenceStudy, Field(discriminator="kind")]
_ADAPTER: TypeAdapter[PairwiseStudy | PreferenceStudy] = TypeAdapter(StudySettings)


def parse_study(text: str, *, name: str = "study.yaml") -> PairwiseStudy | PreferenceStudy:
    """Parse settings from YAML.

    Raises:
        EchoAvatarError: the text is not YAML, or a field is missing, unknown or out of range.
    """
    stored = read_yaml(text, name)
    if not isinstance(stored, dict):
        raise EchoAvatarError(f"{name} holds no settings; begin with `kind: pairwise` or `kind: preference`")
    try:
        study = _ADAPTER.validate_python(stored)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(part) for part in first["loc"] if part not in ("pairwise", "preference")) or "kind"
        raise EchoAvatarError(f"{name}: {place}: {first['msg']}") from error
    if _holds_nul(study.model_dump()):
        raise EchoAvatarError(f"{name}: text and paths may not hold NUL characters")
    return study


def _holds_nul(value: object) -> bool:
    if isinstance(value, dict):
        return any(map(_holds_nul, value.values()))
    if isinstance(value, list | tuple):
        return any(map(_holds_nul, value))
    return isinstance(value, str) and "\0" in value


@lru_cache(maxsize=256)
def kept_study(text: str) -> PairwiseStudy | PreferenceStudy:
    """Parse settings from the store; cached, because every answer needs them."""
    return parse_study(text)


def read_study(path: Path) -> PairwiseStudy | PreferenceStudy:
    """Read settings from a file.

    Raises:
        EchoAvatarError: the file cannot be read, or its settings are invalid.
    """
    text = read_text(path, "see docs/studio.md for its form", largest=YAML_BYTES)
    return parse_study(text, name=path.name)


PAIRWISE_TEMPLATE = """\
kind: pairwise
title: Which moves better?
systems:                       # a model makes its clips; a folder has them (.npz or .bvh named after the sounds)
  - {name: Ours, model: default}
  - {name: Other, clips: other}
sounds:                        # files or folders
  - {path: music, category: dance}
  - {path: speech, category: gesture}
seconds: 10
presentation: sequential       # or side_by_side
raters: 20
tasks_per_rater: 20
training: 1
checks: {identical: 1, corrupted: 1}
"""
PREFERENCE_TEMPLATE = """\
kind: preference
title: Best and worst
model: default
candidates: 8
length: 20                     # chunks of 0.267 s
sounds:
  - {path: speech, category: gesture}
raters: 6
tasks_per_rater: 20
keep: {votes: 3, agreement: 0.6, margin: 0.3}
"""
