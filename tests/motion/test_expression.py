"""Moods: seen in their curves, faded, weaker on lips that speak, and the same when a session goes back."""

import numpy as np
import pytest

from echoavatar.motion.arkit import ARKIT_NAMES
from echoavatar.motion.expression import MOODS, RESTING, Expression, with_mood
from echoavatar.motion.feeling import Feeling
from echoavatar.motion.motion_chunk import MotionChunk
from echoavatar.timing import CHUNK_SAMPLES, SAMPLES_PER_FRAME

SHOWN = {"happy": "mouthSmileLeft", "angry": "browDownLeft", "sad": "browInnerUp", "thinking": "browDownLeft"}
SHOWN |= {"agree": "mouthSmileRight", "disagree": "browDownRight", "dancing": "mouthSmileLeft"}


def chunk(**curves: float) -> MotionChunk:
    face = np.zeros((8, 52), np.float32)
    for name, value in curves.items():
        face[:, ARKIT_NAMES.index(name)] = value
    return MotionChunk(np.zeros((8, 1, 4), np.float32), np.zeros((8, 3), np.float32), face)


@pytest.mark.parametrize(("mood", "curve"), SHOWN.items())
def test_a_mood_can_be_seen_within_a_second_and_leaves_without_a_jump(mood: str, curve: str) -> None:
    session, at, path = Expression(), ARKIT_NAMES.index(curve), []
    for number in range(10):
        face = session.apply(number, chunk(), mood=mood if number < 4 else RESTING).face
        path.append(face[:, at])
    whole = np.concatenate(path)
    assert whole[:32].max() >= 0.4
    assert whole[-1] == pytest.approx(MOODS[RESTING][at], abs=1e-6)
    assert np.abs(np.diff(whole)).max() < 0.2 * whole.max()


def test_lips_that_speak_keep_less_of_a_smile_and_brows_all_of_theirs() -> None:
    """Of a smile, lips keep four fifths with the mouth a little open, a half with the mouth open."""
    added = np.tile(MOODS["happy"], (8, 1))
    quiet, little, speaking = (with_mood(chunk(jawOpen=jaw).face, added)[0] for jaw in (0.0, 0.12, 0.5))
    smile, brow, jaw = (ARKIT_NAMES.index(name) for name in ("mouthSmileLeft", "browOuterUpLeft", "jawOpen"))
    assert 0.35 < speaking[smile] / quiet[smile] < 0.5
    assert 0.7 < little[smile] / quiet[smile] < 0.9
    assert speaking[brow] == quiet[brow]
    assert speaking[jaw] == np.float32(0.5)


def test_what_pulls_the_other_way_gives_in_and_nothing_leaves_0_to_1() -> None:
    face = with_mood(chunk(mouthFrownLeft=0.8, mouthSmileLeft=0.9).face, np.tile(MOODS["happy"], (8, 1)))[0]
    smile = MOODS["happy"][ARKIT_NAMES.index("mouthSmileLeft")]
    assert face[ARKIT_NAMES.index("mouthFrownLeft")] == pytest.approx(0.8 * (1 - smile))
    assert 0 <= face.min() <= face.max() <= 1


def test_a_chunk_made_again_is_the_same_and_a_session_without_a_face_stays_without() -> None:
    session = Expression()
    first = [session.apply(number, chunk(), mood="sad").face for number in range(3)]
    again = [session.apply(number, chunk(), mood="sad").face for number in (1, 2)]
    np.testing.assert_array_equal(np.stack(again), np.stack(first[1:]))
    assert session.apply(3, chunk()._replace(face=None), mood="sad").face is None


def test_a_mood_that_fades_in_a_chunk_made_again_has_the_strength_that_it_had() -> None:
    session = Expression()
    session.apply(0, chunk(), mood="happy", strength=0.5)
    first = session.apply(1, chunk()).face
    session.apply(1, chunk(), mood="happy", strength=1.3)
    np.testing.assert_array_equal(session.apply(1, chunk()).face, first)


def test_a_mood_that_becomes_stronger_does_so_without_a_jump() -> None:
    """As by an action that follows another of its name."""
    session, smile = Expression(), ARKIT_NAMES.index("mouthSmileLeft")
    strengths = (0.5, 0.5, 0.5, 1.3, 1.3)
    faces = [session.apply(k, chunk(), mood="happy", strength=size).face for k, size in enumerate(strengths)]
    path = np.concatenate(faces)[:, smile]
    assert path[-1] > 2 * path[20] > 0.4
    assert np.abs(np.diff(path)).max() < 0.1


def test_a_face_shows_what_the_voice_feels_with_lips_that_can_close() -> None:
    """Surely felt joy smiles without parting closed lips; at strength 0, and in another mood, nothing changes."""

    class Joyful(Feeling):
        def hear(self, chunk, speech):
            return np.tile([1.0, 0.0, 0.0], (len(speech) // SAMPLES_PER_FRAME, 1))

    speech, faces = np.zeros(CHUNK_SAMPLES, np.float32), []
    for strength, mood in ((0.7, RESTING), (0.0, RESTING), (0.7, "sad")):
        session = Expression(feeling=strength, voice=Joyful())
        for number in range(8):
            face = session.apply(number, chunk(), mood=mood, speech=speech).face[-1]
        faces.append(dict(zip(ARKIT_NAMES, face, strict=True)))
    joy, plain, sad = faces
    assert joy["mouthSmileLeft"] == pytest.approx(0.42, abs=0.01)
    assert joy["cheekSquintLeft"] > 0.4
    assert joy["mouthUpperUpLeft"] == joy["mouthLowerDownLeft"] == joy["jawOpen"] == 0
    assert plain["mouthSmileLeft"] == pytest.approx(0.1, abs=0.01)
    assert sad["mouthSmileLeft"] == 0
