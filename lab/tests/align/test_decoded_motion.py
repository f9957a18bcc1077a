"""Decoded motion is that of the clip at the prompt's position."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from lab.tests.align.tuning_fakes import clips

from echoavatar.motion.kinematics import HUMANOID, forward_kinematics
from echoavatar.motion.kinematics.rotations import matrix_from_quaternion
from echoavatar.motion.stages.pose import Pose, Unpacking
from echoavatar.motion.stages.smoother import Smoother
from echoavatar.timing import CHUNK_FRAMES, FRAME_RATE_HZ
from echoavatar_lab.align.decoded_motion import decode_continuations, decode_truth, shown_positions
from echoavatar_lab.align.prompts import PromptSampler
from echoavatar_lab.models.tokenizer.model import BodyTokenizer


def test_the_truth_is_the_clip_decoded_as_a_whole(tiny_bundle: Path):
    """Past of 12 tokens, 10 of them decoded, 2 kept as lead: by then decoder and smoother forgot where they began."""
    tokenizer = BodyTokenizer.load(tiny_bundle / "tokenizer")
    clip = clips(1, chunks=9)["clip0"]
    prompt = PromptSampler({"clip0": clip}, past=6, length=2).cut("clip0", 1)
    (made,) = decode_truth(tokenizer, [prompt])
    features = tokenizer.decode(torch.from_numpy(clip.motion[None]).long()).detach()
    positions = shown_positions(tokenizer.skeleton, features)[0].numpy()
    begin = (1 + 6) * 8
    np.testing.assert_allclose(
        made.positions[made.lead :] - made.positions[made.lead :, :1],
        (positions - positions[:, :1])[begin : begin + 16],
        atol=1e-4,
    )
    assert (made.lead, made.frames) == (8, 16)
    assert made.audio_codes.shape == (40, 2)


def test_positions_are_those_of_the_pipelines_smoother():
    """Bodies whose joints jump, some faster than the smoother lets them."""
    random = torch.Generator().manual_seed(0)
    features = 0.1 * torch.randn(3, 48, 315, generator=random)
    pose, _ = Unpacking(HUMANOID).pose_of(features.numpy(), FRAME_RATE_HZ)
    smoother = Smoother(HUMANOID.joints)
    state = smoother.init_state(3)
    for start in range(0, 48, CHUNK_FRAMES):
        at = slice(start, start + CHUNK_FRAMES)
        smoother.step(Pose(pose.rotations[:, at], pose.root[:, at], pose.fps), state, np.ones(3, bool))
    pose.root[..., ::2] = pose.root[..., ::2].cumsum(1)
    wanted = forward_kinematics(HUMANOID, matrix_from_quaternion(pose.rotations), pose.root).positions
    np.testing.assert_allclose(shown_positions(HUMANOID, features), wanted, atol=1e-4)


def test_rows_go_with_their_prompts(tiny_bundle: Path):
    tokenizer = BodyTokenizer.load(tiny_bundle / "tokenizer")
    book = PromptSampler(clips(), past=2, length=1)
    prompts = [replace(book.cut("clip0", 0), beats=np.array([0.1])), book.cut("clip1", 2)]
    codes = torch.randint(8, (6, 2, 3, 2), generator=torch.Generator().manual_seed(0))
    scenes = decode_continuations(tokenizer, prompts, codes)
    assert [len(one.beats) for one in scenes[:3]] == [1, 1, 1]
    (alone,) = decode_continuations(tokenizer, prompts[1:], codes[4:5])
    np.testing.assert_allclose(alone.positions, scenes[4].positions, atol=1e-5)
    assert scenes[0].speed().shape == (8,)
