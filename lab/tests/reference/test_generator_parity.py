"""An imported generator against transformers reading the download itself: full vocabulary, chat prompt, masks."""

from pathlib import Path

import pytest
import torch
from lab.tests.reference.conftest import bundle_of
from scripts.synthetic_release import make

from echoavatar.engine.pipeline import load_bundle
from echoavatar_lab.models.generator.stream import open_stream
from echoavatar_lab.models.tokens import audio_ids, motion_ids
from echoavatar_lab.reference.weights import REFERENCE_LAYOUT

transformers = pytest.importorskip("transformers")


@pytest.fixture(scope="module")
def download(tmp_path_factory) -> Path:
    return make(tmp_path_factory.mktemp("download"), "small", seed=5)


@torch.no_grad()
def test_the_likeliest_codes_of_a_step_with_an_example(download, tmp_path) -> None:
    """6 system ids with one example code, 608 of audio and framing, 504 of motion; 36 codes, the rest masked out."""
    generator = load_bundle(bundle_of(download, tmp_path / "bundle")).generator
    config, K = generator.config, 512
    stream, one = open_stream(generator), torch.ones(1, dtype=torch.bool)
    audio = torch.randint(1024, (1, 20, 2), generator=torch.Generator().manual_seed(0))
    members = torch.zeros(1, 2 * K)
    members[0, [7, K + 495]] = 1
    ours = stream.step(
        audio, stream.init_state(1), one, temperature=torch.zeros(1), exemplar=members, bias=20 * members
    )
    theirs = transformers.Qwen2ForCausalLM.from_pretrained(
        download / "ckpts/body_g_d", local_files_only=True, dtype=torch.float32
    ).eval()
    layout = REFERENCE_LAYOUT
    told = [layout.segment_start(6) + 7, layout.segment_start(0) + 495]
    sound = torch.cat([torch.tensor([config.opening.silence]).expand(280, 2), audio[0]])
    ids = [151_644, 8_948, 198, *told, 151_645, 198, 151_644, 872, 198]
    ids += audio_ids(layout, sound[None])[0].tolist()
    ids += [151_645, 198, 151_644, 77_091, 198]
    ids += motion_ids(layout, torch.full((1, 28, 3, 6), 32))[0].tolist()
    codes: list[int] = []
    assert len(ids) == 5 + 2 + 608 + 504
    for index in range(36):
        states = theirs.model(torch.tensor([ids]), use_cache=False).last_hidden_state  # names of caches change
        logits = theirs.lm_head(states[0, -1])
        logits[told] += 20
        start = layout.segment_start(index % 18)
        codes.append(int(logits[start : start + K].argmax()))
        ids.append(start + codes[-1])
    assert ours.flatten(1)[0].tolist() == codes
    assert codes[6] == codes[24] == 7
    assert codes[0] == codes[18] == 495
