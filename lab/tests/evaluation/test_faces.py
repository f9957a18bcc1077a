import numpy as np
import pytest

from echoavatar.engine.pipeline import Bundle
from echoavatar.engine.pipeline.runtime import Runtime
from echoavatar.errors import EchoAvatarError
from echoavatar.models.face import FaceConfig, MelConfig
from echoavatar.motion.arkit import ARKIT_NAMES
from echoavatar_lab.corpora.rehearsal.track import compose_track
from echoavatar_lab.corpora.speech.lips import lip_curves
from echoavatar_lab.evaluation import faces
from echoavatar_lab.evaluation.faces import evaluate_face
from echoavatar_lab.models.face.model import FaceModel


@pytest.fixture(scope="module")
def track():
    return compose_track(5, 20.0, mix="speech", engine="own")


def scored(monkeypatch, track, curves):
    monkeypatch.setattr(faces, "animate_face", lambda stream, audio, seed: curves)
    tiny = FaceModel(FaceConfig(encoder=MelConfig(bands=8, width=8, blocks=1), width=16, heads=2, layers=1))
    return evaluate_face(Bundle.of("fake", Runtime(), face=tiny), [track], [track.audio])


def test_the_truth_scores_as_truth(monkeypatch, track):
    scores = scored(monkeypatch, track, lip_curves(track, ARKIT_NAMES))
    assert scores.mouth_pearson == pytest.approx(1)
    assert scores.lip_lag_frames == 0
    assert scores.closed_on_pbm == scores.closed_on_pbm_truth > 0.9
    assert scores.closed_elsewhere < scores.closed_on_pbm
    assert scores.silent_motion < 0.05
    assert scores.envelope_pearson > 0.2


def test_late_lips_are_told_late_and_stray_ones_score_badly(monkeypatch, track):
    truth = lip_curves(track, ARKIT_NAMES)
    assert scored(monkeypatch, track, np.roll(truth, 3, axis=0)).lip_lag_frames == 3
    stray = scored(monkeypatch, track, truth[::-1])
    assert stray.mouth_pearson < 0.5
    assert stray.closed_on_pbm < 0.9


def test_a_bundle_without_a_face_is_named():
    with pytest.raises(EchoAvatarError, match="train face"):
        evaluate_face(Bundle.of("fake", Runtime()), [])
