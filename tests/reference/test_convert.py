"""The bundle that comes of a download: the same numbers, and it moves an avatar from the first chunk on."""

import json

import numpy as np
import pytest
import torch

from echoavatar.cli import main
from echoavatar.engine import Engine
from echoavatar.errors import CheckpointError, EchoAvatarError
from echoavatar.pipeline import Pipeline, load_bundle
from echoavatar.reference import Release, convert, survey
from echoavatar.reference.untrusted import read_tensors
from echoavatar.reference.weights import StoredGenerator


@pytest.fixture(scope="module")
def bundle(imported):
    return load_bundle(imported)


def test_weights_are_theirs_to_the_bit(bundle, download):
    release = Release(download / "ckpts", download / "stats")
    own, theirs = bundle.tokenizer.state_dict(), read_tensors(release.tokenizer("hands"), "net")
    assert all(torch.equal(own[f"parts.hands.{key}"], value) for key, value in theirs.items())
    stored = StoredGenerator.open(release.generator())
    body = [key for key in stored.shapes if key.startswith("model.layers")]
    mine = bundle.generator.state_dict()
    assert all(torch.equal(mine[key], stored.read(key).float()) for key in body)
    theirs = stored.read("lm_head.weight")[156_690 : 156_690 + 18 * 512].float()
    assert torch.equal(bundle.generator.segment_head().flatten(0, 1), theirs)


def test_everything_about_running_it_is_data(bundle, imported):
    assert bundle.generator.config.sequence == "prefix"
    assert not bundle.runtime.level_control
    assert bundle.runtime.silent_temperature == 1.0
    assert bundle.face.config.context == 56
    assert list(bundle.actions) == ["idle", "wave", "stand"]
    card = json.loads((imported / "card.json").read_text())
    assert "without a licence" in card["warning"]
    silent = bundle.codec.encode(torch.zeros(1, 96_000))[0, -1].tolist()
    assert list(bundle.generator.config.opening.silence) == silent


def test_a_download_with_problems_is_not_converted(spoilt, bundle, tmp_path):
    path = spoilt("stats/zm_meta_info.npz")
    path.unlink()
    found = survey(Release(path.parents[1] / "ckpts", path.parent))
    with pytest.raises(CheckpointError, match=r"zm_meta_info\.npz is missing"):
        convert(found, bundle.codec, tmp_path / "out", actions=bundle.actions)
    assert not (tmp_path / "out").exists()


def test_it_moves_from_the_first_chunk_and_can_be_taken_back(bundle, voice):
    """One chunk of sound gives eight frames; the same again after `clear`; an action draws codes of its set only."""
    drawn = []
    pipeline = Pipeline(bundle)
    decode = pipeline.tokenizer.decode_step
    pipeline.tokenizer.decode_step = lambda codes, *rest: (drawn.append(codes), decode(codes, *rest))[1]
    with Engine(pipeline).open(seed=2) as session:
        session.push(voice[:12_800])
        (first, second) = list(session)
        assert first.rotations.shape == (8, 52, 4)
        assert first.face.shape == (8, 52)
        session.clear(6_400)
        session.push(voice[6_400:12_800])
        again = list(session)[0]
        assert len(drawn) == 3
        assert torch.equal(drawn[1], drawn[2])  # the same sound after the same past
        assert np.isfinite(again.rotations).all()
        session.act("stand")
        session.push(voice[12_800:19_200])
        list(session)
    assert set(drawn[-1][0, :, 1, 0].tolist()) <= {7, 9}
    assert set(drawn[-1][0, :, 0, 0].tolist()) == {495}


def test_the_releases_step_of_three_tokens_is_a_chunk_of_twelve_frames(download, tmp_path, voice):
    """Through the pipeline; the window's context is 27 tokens, the face's 52 frames."""
    from tests.reference.conftest import bundle_of

    bundle = load_bundle(bundle_of(download, tmp_path / "release", step=3))
    assert bundle.face.config.context == 52
    pipeline = Pipeline(bundle)
    state, one = pipeline.init_state(1), torch.ones(1, dtype=torch.bool)
    assert pipeline.chunk_samples == 9_600
    for start in (0, 9_600):
        (chunk,) = pipeline.step(torch.from_numpy(voice[None, start : start + 9_600]), state, one)
        assert chunk.rotations.shape == (12, 52, 4)
        assert chunk.face.shape == (12, 52)
        assert np.isfinite(chunk.root).all()
    with pytest.raises(EchoAvatarError, match="--step 2"):
        Engine(pipeline)


def test_its_actions_are_not_made_of_clips_on_our_rig(imported, capsys):
    assert main(["actions", "remove", "wave", "--bundle", str(imported)]) == 1
    assert "actions came with it" in capsys.readouterr().err
    assert main(["actions", "list", "--bundle", str(imported)]) == 0
    assert "3 actions" in capsys.readouterr().out
