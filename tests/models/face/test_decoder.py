"""The compiled frame loop of a face is its model; sessions of one batch do not see each other."""

import numpy as np
import pytest
import torch
from tests.models.face.tiny import CONFIG, make

from echoavatar.errors import CheckpointError
from echoavatar.models.face.decoder import FrameDecoder
from echoavatar_lab.models.face.model import FaceModel


def drawn(seed: int, rows: int, frames: int = 8) -> tuple[np.ndarray, np.ndarray]:
    """What frames hear, and noise."""
    random = np.random.default_rng(seed)
    sizes = (rows, frames, CONFIG.width), (rows, frames, 52)
    heard, noise = (random.standard_normal(size, np.float32) for size in sizes)
    return heard, noise


def tiny(steps: int = 2, guidance: float = CONFIG.guidance) -> FaceModel:
    return make(CONFIG.model_copy(update={"sampling_steps": steps, "guidance": guidance})).float()


def loop(model: FaceModel) -> FrameDecoder:
    return FrameDecoder(model.config, {name: weight.numpy() for name, weight in model.state_dict().items()})


def test_a_session_alone_gets_the_face_that_it_gets_in_company():
    decoder, (sound, noise) = loop(tiny()), drawn(1, 40)

    def frames(rows: slice) -> np.ndarray:
        heard = sound[rows]
        return decoder.step(heard, decoder.init_state(len(heard)), np.ones(len(heard), np.bool_), noise[rows])

    together = frames(slice(None))
    for row in (0, 1, 17, 39):
        np.testing.assert_array_equal(frames(slice(row, row + 1))[0], together[row])
    assert np.abs(together[0] - together[1]).max() > 0.01


@torch.no_grad()
@pytest.mark.parametrize(("frames", "steps", "guidance"), [(8, 3, 1.7), (8, 1, 1.0), (48, 2, 2.0)])
def test_the_frame_loop_is_the_model_read_as_a_whole(frames, steps, guidance):
    """Each frame is what backbone and head say of everything before it; 48 of them go round a ring of 12 slots."""
    model = tiny(steps, guidance)
    decoder, (sound, noise), active = loop(model), drawn(3, 2, frames), np.array([True, True])
    state = decoder.init_state(2)
    chunks = [slice(first, first + 8) for first in range(0, frames, 8)]
    parts = [decoder.step(sound[:, chunk], state, active, noise[:, chunk]) for chunk in chunks]
    made = torch.from_numpy(np.concatenate(parts, 1))
    np.testing.assert_array_equal(state.last, made[:, -1])
    assert state.seen.tolist() == [frames, frames]

    heard, schedule = torch.from_numpy(sound), model.head.schedule(steps)
    motion = torch.cat([torch.zeros(2, 1, 52), made[:, :-1]], 1)
    branches = [model.gpt(motion, each) for each in (torch.zeros_like(heard), heard)]
    for i in range(frames):
        condition = torch.stack([branch[:, i] for branch in branches], 1)
        wanted = model.head.sample(condition, torch.from_numpy(noise[:, i]), schedule, guidance=guidance)
        torch.testing.assert_close(made[:, i], wanted, atol=1e-4, rtol=1e-4)


def test_idle_rows_keep_their_ring_and_get_nothing():
    decoder, (sound, noise) = loop(tiny(1)), drawn(5, 2)
    state = decoder.init_state(2)
    state.ring[:] = np.random.default_rng(6).standard_normal(state.ring.shape)
    before = state.ring.copy()
    frames = decoder.step(sound, state, np.array([False, True]), noise)
    np.testing.assert_array_equal(state.ring[0], before[0])
    assert state.seen.tolist() == [0, 8]
    assert not np.array_equal(state.ring[1], before[1])
    assert not frames[0].any()
    assert frames[1].any()


def test_weights_that_do_not_fit_are_named_before_the_loop_reads_beyond_them():
    weights = {name: weight.numpy() for name, weight in tiny().state_dict().items()}
    for name in ("gpt.blocks.1.attn.qkv.weight", "head.mlps.0.fc2.bias", "gpt.blocks.0.attn.bias"):
        with pytest.raises(CheckpointError, match=rf"{name} is \(\d+.*\), wanted"):
            FrameDecoder(CONFIG, {**weights, name: weights[name][1:]})
        with pytest.raises(CheckpointError, match=f"{name} is missing"):
            FrameDecoder(CONFIG, {other: weight for other, weight in weights.items() if other != name})


def test_an_ear_of_another_width_is_refused():
    decoder, (sound, noise) = loop(tiny()), drawn(7, 1)
    with pytest.raises(CheckpointError, match=r"gives \(1, 8, 15\), wanted \(1, 8, 16\)"):
        decoder.step(sound[..., 1:], decoder.init_state(1), np.ones(1, np.bool_), noise)
