from functools import partial

import numpy as np
import pytest
import torch
from tests.models.face.tiny import CONFIG, clip
from tests.models.runs import check_pieces, check_resume, losses

from echoavatar.errors import CheckpointError
from echoavatar.models.face import FaceStream
from echoavatar.motion.arkit import ARKIT_NAMES
from echoavatar_lab.models.face.recipe import FaceTraining
from echoavatar_lab.models.face.train import FaceTask, train_face
from echoavatar_lab.training import Loop

JAW = ARKIT_NAMES.index("jawOpen")
QUICK = FaceTraining(steps=6, batch=2, frames=16, warmup=1, save_every=2, learning_rate=3e-3)


@pytest.mark.parametrize("at", [1, 5])
def test_a_killed_run_repeats_the_curve_it_would_have_had(tmp_path, at):
    """Two steps train the encoder alone, then all learn; checkpoints come every second step."""
    training = QUICK.model_copy(update={"listen": 2, "average": 0.5})
    check_resume(partial(train_face, CONFIG, training, [clip()]), tmp_path, at=at)


def test_pieces_share_one_trajectory():
    """Four windows at once or one after the other, with the noise that each has in either."""

    def make(pieces):
        training = QUICK.model_copy(update={"batch": 4, "accumulation": pieces, "listen": 1})
        return FaceTask(CONFIG, training, [clip()])

    check_pieces(make, 4)


def test_another_schedule_or_size_is_refused(tmp_path):
    Loop(FaceTask(CONFIG, QUICK, [clip()])).save(tmp_path)
    with pytest.raises(CheckpointError, match="another training config: seed"):
        train_face(CONFIG, QUICK.model_copy(update={"seed": 1}), [clip()], tmp_path)
    with pytest.raises(CheckpointError, match="another face config: width"):
        train_face(CONFIG.model_copy(update={"width": 32}), QUICK, [clip()], tmp_path)


def test_it_learns_to_open_the_jaw_with_the_sound(tmp_path):
    """A tiny model overfits one clip: streamed from nothing but sound, its jaw follows the truth."""
    training = FaceTraining(steps=250, batch=8, frames=32, warmup=10, learning_rate=5e-3, save_every=1000)
    model = train_face(CONFIG, training, [clip()], tmp_path)
    curve = list(losses(tmp_path).values())
    assert np.mean(curve[-20:]) < 0.35 * np.mean(curve[:10])
    truth = clip()
    stream, active = FaceStream(model), torch.ones(1, dtype=torch.bool)
    audio = torch.from_numpy(truth.audio)[None]
    curves = stream.step(audio, stream.init_state(1), active, torch.tensor([5]))[0].numpy()
    assert np.corrcoef(curves[:, JAW], truth.curves[:, JAW])[0, 1] > 0.8
    mouth = [i for i, name in enumerate(ARKIT_NAMES) if name.startswith(("mouth", "jaw")) and i != JAW]
    assert np.abs(curves[:, mouth]).max() == 0


def test_a_new_run_begins_with_another_models_weights(tmp_path):
    first = train_face(CONFIG, QUICK, [clip()], tmp_path / "first")
    still = QUICK.model_copy(update={"learning_rate": 1e-12})
    second = train_face(CONFIG, still, [clip()], tmp_path / "second", start=first)
    for key, value in first.state_dict().items():
        torch.testing.assert_close(second.state_dict()[key], value, atol=1e-6, rtol=1e-5)


def test_at_first_only_the_encoder_learns():
    """Two steps of listening, then one of all; with a rate of its own for either phase."""
    training = QUICK.model_copy(update={"listen": 2, "listening_rate": 1e-2, "warmup": 0})
    loop = Loop(FaceTask(CONFIG, training, [clip()]))
    before = {key: value.clone() for key, value in loop.stage.model.state_dict().items()}
    assert loop.stage.rate(0, 0.0) == 1e-2
    assert loop.stage.rate(2, 0.5) == training.learning_rate
    for _ in range(2):
        loop.advance()

    def changed() -> set[str]:
        after = loop.stage.model.state_dict()
        return {key.split(".")[0] for key, value in before.items() if not torch.equal(after[key], value)}

    assert changed() == {"encoder"}
    loop.advance()
    assert changed() == {"encoder", "gpt", "head"}


def test_the_encoder_alone_learns_to_tell_the_jaw():
    """The readout's error falls to a third within 60 steps of a tiny encoder on one clip."""
    training = FaceTraining(steps=60, listen=60, batch=8, frames=32, warmup=5, listening_rate=1e-2)
    loop = Loop(FaceTask(CONFIG, training, [clip()]))
    errors = [loop.advance()["read"] for _ in range(60)]
    assert np.mean(errors[-5:]) < np.mean(errors[:3]) / 3
