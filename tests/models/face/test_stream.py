import numpy as np
import pytest
import torch
from tests.models.face.tiny import CONFIG, Seeded, make, sound

from echoavatar.engine.pipeline import load_bundle
from echoavatar.models.face import FaceStream
from echoavatar.models.face.noise import face_noise
from echoavatar.timing import CHUNK_SAMPLES

ALL = np.ones(1, np.bool_)


def test_eight_frames_of_52_curves_between_0_and_1_per_chunk():
    curves = Seeded(make())(sound(2, 2 * CHUNK_SAMPLES, torch.Generator().manual_seed(1)))
    assert curves.shape == (2, 16, 52)
    assert curves.min() >= 0
    assert curves.max() <= 1
    assert curves.std() > 0.01


def test_pieces_that_are_no_chunks_are_refused():
    stream = make().stream()
    with pytest.raises(ValueError, match="6400"):
        stream.step(np.zeros((1, 800), np.float32), stream.init_state(1), ALL, np.array([0]))


@torch.no_grad()
@pytest.mark.parametrize("memory", ["ring", "window"])
def test_a_naive_loop_gives_the_same_frames(memory):
    """Without any cache: both guidance branches apart, the whole past anew for every frame."""
    model = make(CONFIG.model_copy(update={"memory": memory}))
    config, gpt, head = model.config, model.gpt, model.head
    audio = sound(1, 4 * CHUNK_SAMPLES, torch.Generator().manual_seed(2))
    stream = model.stream()
    ours = torch.from_numpy(stream.step(audio.numpy(), stream.init_state(1), ALL, np.array([7])))

    features = model.encoder(audio)
    noise = torch.from_numpy(face_noise(np.array([7]), np.array([0]), count=32, channels=52, hold=config.noise_hold))
    silence = torch.zeros(1, config.context - 1, config.encoder.outputs).double()
    past = 0 if memory == "ring" else config.context - 1
    motion = torch.zeros(1, 1 + past, 52).double()
    known = features if memory == "ring" else torch.cat([silence, features], 1)
    for frame in range(32):
        first = 0 if memory == "ring" else frame // 8 * 8
        heard = gpt.sound_proj(known[:, first : past + frame + 1])
        blank = gpt(motion[:, first:], torch.zeros_like(heard))[:, -1]
        full = gpt(motion[:, first:], heard)[:, -1]
        x = noise[:, frame]
        for time, level, following in ((1000, 1.0, 0.5005), (500, 0.5005, 0.001), (1, 0.001, 0.0)):
            without, with_sound = (head(x, torch.tensor([time]), c) for c in (blank, full))
            face = without + config.guidance * (with_sound - without)
            x = x + (following - level) * (x - face) / level
        motion = torch.cat([motion, x[:, None]], 1)
    wanted = model.denormalize(motion[:, past + 1 :]).clamp(0, 1)
    torch.testing.assert_close(ours.double(), wanted, atol=1e-5, rtol=0)  # time tables and the ring are float32


def test_a_face_without_torch_is_the_same_face():
    """The shipped one: its weights as arrays and its ear as a graph, beside the model."""
    bundle = load_bundle()
    graph = bundle.parts["face"].graph
    weights = {name: weight.numpy() for name, weight in bundle.face.state_dict().items()}
    audio = sound(2, 3 * CHUNK_SAMPLES, torch.Generator().manual_seed(4)).float().numpy()

    def run(stream: FaceStream) -> np.ndarray:
        return stream.step(audio, stream.init_state(2), np.ones(2, np.bool_), np.array([1, 2]))

    made = run(FaceStream(bundle.face.config, weights, graph))
    np.testing.assert_allclose(made, run(bundle.face.stream()), atol=1e-4)
    assert made.std() > 0.01


def test_another_seed_is_another_face_and_guidance_reaches_the_result():
    model = make()
    audio = sound(1, CHUNK_SAMPLES, torch.Generator().manual_seed(3)).numpy()

    def run(seed: int) -> np.ndarray:
        stream = model.stream()
        return stream.step(audio, stream.init_state(1), ALL, np.array([seed]))

    assert np.array_equal(run(1), run(1))
    assert not np.allclose(run(1), run(2))
    before = run(1)
    model.config = model.config.model_copy(update={"guidance": 1.0})
    assert not np.allclose(run(1), before)
