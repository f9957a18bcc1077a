"""How a bundle wants to be run travels beside its checkpoints."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import echoavatar
from echoavatar.engine import Engine, animate
from echoavatar.engine.pipeline import Pipeline, load_bundle
from echoavatar.engine.pipeline.runtime import ADDITIONS, Runtime
from echoavatar.errors import CheckpointError, EchoAvatarError
from echoavatar.models.audio import read_audio
from echoavatar.motion.kinematics import HUMANOID
from echoavatar.motion.stages.modes import MotionOptions
from echoavatar.motion.stages.post import SWITCHES
from echoavatar.timing import CHUNK_SAMPLES


def test_without_the_file_everything_is_as_ours(tmp_path):
    assert Runtime.load(tmp_path) == Runtime()
    assert Runtime().stages == SWITCHES


def test_it_comes_back(tmp_path):
    own = Runtime(level_control=False, lead_in_s=0.5, stages=("smoother",))
    own.save(tmp_path)
    assert Runtime.load(tmp_path) == own


def test_the_pipeline_obeys(tiny_bundle):
    bundle = replace(load_bundle(tiny_bundle), runtime=Runtime(level_control=False, stages=("smoother",)))
    assert Pipeline(bundle).level is None
    assert Pipeline(bundle).post.stages == {"smoother"}
    assert Pipeline(bundle, stages=("feet",)).post.stages == {"feet"}


def test_a_damaged_file_is_named(tmp_path):
    (tmp_path / "runtime.json").write_text('{"level_control": 3.5}')
    with pytest.raises(CheckpointError, match=r"runtime\.json: level_control"):
        Runtime.load(tmp_path)


def test_without_the_file_sound_is_leveled_as_the_generators_was(tmp_path) -> None:
    assert not Runtime.load(tmp_path, is_leveled=False).level_control
    own = Runtime(level_control=True)
    own.save(tmp_path)
    assert Runtime.load(tmp_path, is_leveled=False) == own


def test_the_papers_runtime_has_nothing_of_ours() -> None:
    paper = Runtime().chosen("paper")
    assert paper.additions == ()
    assert paper.label == "paper"
    assert not paper.level_control
    assert paper.lead_in_s == 0
    assert paper.cylinder


def test_every_addition_has_a_switch() -> None:
    assert Runtime().label == "default"
    assert Runtime().additions == ADDITIONS
    for name in ADDITIONS:
        assert Runtime().chosen(name).label == name
        assert Runtime().chosen("paper").chosen(name).label == name  # also where the bundle has it off
    kept = Runtime(lead_in_s=0.5).chosen("lead-in,hands")
    assert (kept.label, kept.lead_in_s, kept.cylinder) == ("lead-in,hands", 0.5, False)
    with pytest.raises(EchoAvatarError, match="no runtime 'breath'.*idle"):
        Runtime().chosen("breath")


def test_a_subset_is_told_and_comes_back() -> None:
    chosen = Runtime().chosen("feet, ground")
    assert Runtime().chosen(chosen.label) == chosen


def test_without_ours_a_body_in_silence_does_not_breathe(tiny_bundle):
    """The session shows what the pipeline made, bit for bit; with idle motion alone the spine breathes."""
    silence = [np.zeros(CHUNK_SAMPLES * 4, np.float32)]
    bundle = load_bundle(tiny_bundle)
    shown = {how: animate(Pipeline(bundle.running(how)), silence, seed=3).motion for how in ("paper", "idle")}
    breathing = [HUMANOID.index(name) for name in ("spine", "chest", "upperChest", "leftShoulder", "rightShoulder")]
    assert degrees(shown["paper"].rotations, shown["idle"].rotations)[:, HUMANOID.index("spine")].max() > 0.1
    pipeline, one = Pipeline(bundle.running("paper")), np.ones(1, np.bool_)
    state = pipeline.init_state(1)
    pipeline.reset(state, one, seed=3)
    bare = [pipeline.step(np.zeros((1, CHUNK_SAMPLES), np.float32), state, one)[0].rotations.copy() for _ in range(4)]
    np.testing.assert_array_equal(np.concatenate(bare), shown["paper"].rotations)
    assert (degrees(np.concatenate(bare), shown["paper"].rotations)[:, breathing] == 0).all()  # exactly


def degrees(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Angles between quaternions (t, j, 4); exactly 0 where they are equal bit for bit."""
    chord = np.linalg.norm(one.astype(np.float64) - other, axis=-1)
    return np.degrees(4 * np.arcsin(np.clip(chord / 2, 0, 1)))


def machinery(runtime: Runtime, bundle) -> set[str]:
    """What of ours a pipeline of this runtime has, read off the pipeline itself."""
    pipeline = Pipeline(replace(bundle, runtime=runtime))
    on = {*pipeline.post.stages, *pipeline.additions}
    on |= {"level"} if pipeline.level else set()
    on |= {"lead-in"} if pipeline._lead_in else set()  # noqa: SLF001
    return on | ({"cylinder"} if pipeline.cylinder else set())


def test_each_switch_puts_in_exactly_its_part(tiny_bundle) -> None:
    bundle = load_bundle(tiny_bundle)
    assert machinery(Runtime().chosen("bare"), bundle) == set()
    assert machinery(Runtime().chosen("paper"), bundle) == {"cylinder"}
    for name in ADDITIONS:
        instead = set() if name == "hands" else {"cylinder"}  # both keep hands off the body
        assert machinery(Runtime().chosen(name), bundle) == {name} | instead
    assert machinery(Runtime(), bundle) == set(ADDITIONS)


BODY, FACE = {"body"}, {"face"}
CHANGES = {
    "level": BODY | FACE,  # both hear it
    "lead-in": BODY | FACE,
    "smoother": BODY,
    "stillness": BODY,  # arms that rest, a trunk that takes part; the face keeps its curves
    "ground": BODY,
    "leash": BODY,
    "feet": BODY,
    "hands": BODY,
    "settling": BODY,
    "home": set(),  # a leash keeps it near already; `test_after_a_dance_it_steps_back_to_its_place`
    "idle": BODY,
    "expression": FACE,
    "blinks": FACE,
    "listening": BODY | FACE,  # a turned head, and eyes that meet
    "gaze": BODY | FACE,  # eyes that meet and glance away; the head helps
    "overlays": BODY,
}


@pytest.mark.slow
@pytest.mark.parametrize("name", ADDITIONS)
def test_each_switch_shows_where_it_belongs_and_nowhere_else(name: str, papers) -> None:
    """The default bundle dances to music that breaks off, then the user speaks, then it acts; on a leash."""
    made = scene(name)
    changed = BODY if any(not np.array_equal(a, b) for a, b in zip(made[:2], papers[:2], strict=True)) else set()
    changed = changed | (set() if np.array_equal(made[2], papers[2]) else FACE)
    assert changed == CHANGES[name]


@pytest.fixture(scope="module")
def papers() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return scene("paper")


def scene(runtime: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rotations, roots and face of one scene."""
    song = 0.1 * read_audio(Path(echoavatar.__file__).parent / "assets/music.ogg")[: 24 * CHUNK_SAMPLES]
    user = np.random.default_rng(0).normal(0, 0.2, 24_000).astype(np.float32)
    engine = Engine(Pipeline(load_bundle().running(runtime)), seats=1, workers=0)
    session = engine.open(seed=3, options=MotionOptions(leash_m=0.2))
    session.push(song)
    session.push(np.zeros(8 * CHUNK_SAMPLES, np.float32))
    shown = []
    for _ in range(32):
        engine.tick()
        shown += list(session)
    session.listen(user)
    session.push(np.zeros(8 * CHUNK_SAMPLES, np.float32))
    for _ in range(8):
        engine.tick()
        shown += list(session)
    session.act("raise_left_hand")
    session.push(np.zeros(12 * CHUNK_SAMPLES, np.float32))
    session.finish()
    shown += list(session)
    parts = [(chunk.rotations, chunk.root, chunk.face) for chunk in shown]
    rotations, root, face = (np.concatenate(part) for part in zip(*parts, strict=True))
    return rotations, root, face


def test_bare_leaves_out_the_papers_cylinder_too(tiny_bundle) -> None:
    bare = Runtime().chosen("bare")
    assert (bare.label, bare.cylinder, bare.additions) == ("bare", False, ())
    assert Pipeline(load_bundle(tiny_bundle).running("bare")).cylinder is None


def test_under_the_papers_runtime_the_user_changes_nothing(tiny_bundle) -> None:
    """Silence is shown alike whether or not a user speaks; with `listening` the head turns to the user."""
    bundle, user = load_bundle(tiny_bundle), np.random.default_rng(0).normal(0, 0.2, 24_000).astype(np.float32)

    def shown(how: str, heard: np.ndarray | None) -> np.ndarray:
        session = Engine(Pipeline(bundle.running(how)), seats=1, workers=0).open(seed=3)
        if heard is not None:
            session.listen(heard)
        session.push(np.zeros(CHUNK_SAMPLES * 8, np.float32))
        session.finish()
        return np.concatenate([chunk.rotations for chunk in session])

    np.testing.assert_array_equal(shown("paper", None), shown("paper", user))
    assert np.abs(shown("listening", None) - shown("listening", user)).max() > 1e-3
