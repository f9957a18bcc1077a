import pytest
import torch
from tests.models.face.tiny import CONFIG, JAW, clip

from echoavatar_lab.models.face.losses import FaceReader, draw_noise, flow_loss, lip_error
from echoavatar_lab.models.face.recipe import FaceTraining
from echoavatar_lab.models.face.train import FaceTask

QUICK = FaceTraining(batch=2, frames=16)


def test_silence_and_lost_history_are_dropped_per_window():
    """With all sound dropped the loss does not depend on it; with none dropped it does."""
    stage = FaceTask(CONFIG, QUICK, [clip()])
    batch = stage.sampler.batch(0, 4)
    deaf = batch._replace(audio=torch.zeros_like(batch.audio))

    def loss(data, share: float) -> float:
        training = QUICK.model_copy(update={"audio_dropout": share})
        features = stage.model.encoder(data.audio)
        noise = draw_noise(data.curves, training, torch.Generator().manual_seed(0))
        return flow_loss(stage.model, data, training, noise, features=features).item()

    assert loss(batch, 1.0) == loss(deaf, 1.0)
    assert loss(batch, 0.0) != loss(deaf, 0.0)


def test_lips_that_should_touch_and_do_not_cost_most():
    shut, open_ = torch.zeros(1, 4, 52), torch.zeros(1, 4, 52)
    open_[..., JAW] = 0.2
    assert lip_error(shut[None], shut) == 0
    assert lip_error(open_[None], shut) == pytest.approx(4 * 4.0)
    assert lip_error(shut[None], open_) == pytest.approx(4.0)


@torch.no_grad()
def test_a_reader_that_tells_face_and_touch_pays_nothing_and_any_other_does():
    """Features are the normalised face and a large logit that its lips touch; the readout passes them on."""
    model = FaceTask(CONFIG, QUICK, [clip()]).model
    curves = torch.zeros(1, 4, 52)
    curves[0, 2:, JAW] = 0.4
    touching = torch.tensor([20.0, 20.0, -20.0, -20.0])
    features = torch.cat([model.normalize(curves), touching[None, :, None]], -1)
    reader = FaceReader(53, 52)
    torch.nn.init.eye_(reader.read.weight)
    torch.nn.init.zeros_(reader.read.bias)
    assert reader.loss(model, features, curves) < 1e-6
    deaf = features.clone()
    deaf[..., -1] *= -1
    assert reader.loss(model, deaf, curves) == pytest.approx(20.0, rel=1e-3)
    assert reader.loss(model, features.flip(1), curves) > 20.0
