import pytest
import torch
from tests.models.face.tiny import CONFIG

from echoavatar.models.face.gpt import FaceGpt


def make(memory: str) -> FaceGpt:
    torch.manual_seed(0)
    return FaceGpt(CONFIG.model_copy(update={"memory": memory})).double().eval()


@pytest.mark.parametrize("memory", ["ring", "window"])
def test_the_state_has_one_size_for_ever(memory):
    gpt = make(memory)
    state, active = gpt.init_state(2), torch.ones(2, dtype=torch.bool)
    shapes = [tensor.shape for tensor in state.tensors()]
    features = torch.randn(2, state.sound.shape[1] + 8, 8).double()
    frames = torch.randn(2, 8, 52).double()
    if memory == "window":  # the ring's frames come from `FrameDecoder`
        run = gpt.begin(state, gpt.sound_proj(features))
        for i in range(8):
            gpt.next(run, frames[:, i], gpt.sound_proj(features)[:, i - 8])
    gpt.commit(state, frames, features, active)
    assert [tensor.shape for tensor in state.tensors()] == shapes
    assert state.seen.tolist() == [8, 8]
    assert torch.equal(state.motion[:, -1], frames[:, -1])


@torch.no_grad()
@pytest.mark.parametrize(("memory", "depth"), [("ring", 23), ("window", 63)])
def test_how_far_back_a_condition_depends_on_motion(memory, depth):
    """Ring: two layers that see 11 frames back each, and itself: 23. Window: all there is."""
    gpt = make(memory)
    motion, sound = torch.randn(1, 63, 52).double(), torch.zeros(1, 63, 16).double()
    before, reached = gpt(motion, sound)[0, -1], 0
    for frame in range(63):
        changed = motion.clone()
        changed[0, frame] += 1
        reached += not torch.equal(gpt(changed, sound)[0, -1], before)
    assert reached == depth


@torch.no_grad()
@pytest.mark.parametrize("memory", ["ring", "window"])
def test_conditions_know_nothing_of_later_frames(memory):
    gpt = make(memory)
    motion, sound = torch.randn(1, 20, 52).double(), torch.randn(1, 20, 16).double()
    whole = gpt(motion, sound)
    torch.testing.assert_close(gpt(motion[:, :12], sound[:, :12]), whole[:, :12])
