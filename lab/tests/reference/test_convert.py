"""The bundle that comes of a download: the same numbers, and it moves an avatar from the first chunk on."""

import json
import shutil

import numpy as np
import pytest
import torch

from echoavatar.cli import main
from echoavatar.engine import Engine
from echoavatar.engine.pipeline import Pipeline, load_bundle
from echoavatar.errors import CheckpointError
from echoavatar.motion.formats import write_bvh
from echoavatar_lab.corpora.rehearsal.action_clips import SCRIPTS, clip
from echoavatar_lab.foreign.foreign_files import read_tensors
from echoavatar_lab.reference import Release, convert, inspect_release
from echoavatar_lab.reference.weights import StoredGenerator


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
    assert not bundle.generator.config.is_leveled
    assert bundle.runtime.lead_in_s == 0
    assert bundle.face.config.context == 56
    assert list(bundle.actions) == ["idle", "wave", "stand"]
    card = json.loads((imported / "card.json").read_text())
    assert "without a licence" in card["warning"]
    silent = bundle.codec.encode(torch.zeros(1, 96_000))[0, -1].tolist()
    assert list(bundle.generator.config.opening.silence) == silent


def test_a_download_with_problems_is_not_converted(spoilt, bundle, tmp_path):
    path = spoilt("stats/zm_meta_info.npz")
    path.unlink()
    found = inspect_release(Release(path.parents[1] / "ckpts", path.parent))
    with pytest.raises(CheckpointError, match=r"zm_meta_info\.npz is missing"):
        convert(found, bundle.codec, tmp_path / "out", actions=bundle.actions)
    assert not (tmp_path / "out").exists()


def test_it_moves_from_the_first_chunk_and_can_be_taken_back(bundle, voice):
    """One chunk of sound gives eight frames; the same again after `clear`; an action draws codes of its set only."""
    drawn = []
    pipeline = Pipeline(bundle)
    decode = pipeline.decoder.step
    pipeline.decoder.step = lambda codes, *rest: (drawn.append(codes), decode(codes, *rest))[1]
    with Engine(pipeline).open(seed=2) as session:
        session.push(voice[:12_800])
        (first, second) = list(session)
        assert first.rotations.shape == (8, 52, 4)
        assert first.face.shape == (8, 52)
        session.clear(6_400)
        session.push(voice[6_400:12_800])
        again = list(session)[0]
        assert len(drawn) == 3
        assert np.array_equal(drawn[1], drawn[2])  # the same sound after the same past
        assert np.isfinite(again.rotations).all()
        session.act("stand")
        session.push(voice[12_800:19_200])
        list(session)
    assert set(drawn[-1][0, :, 1, 0].tolist()) <= {7, 9}
    assert set(drawn[-1][0, :, 0, 0].tolist()) == {495}


def test_a_clip_for_it_lasts_half_a_second_to_twenty(imported, tmp_path, capsys):
    folder, waving = shutil.copytree(imported, tmp_path / "mine"), clip(SCRIPTS["wave"])
    for frames, is_refused in (14, True), (15, False), (600, False), (601, True):
        at = np.arange(frames) % waving.frames
        write_bvh(tmp_path / "w.bvh", waving.skeleton, waving.rotations[at], waving.root[at], fps=30)
        assert main(["actions", "add", f"w {frames}", str(tmp_path / "w.bvh"), "--model", str(folder)]) == is_refused
        assert ("cut it to 0.5 to 20 s" in capsys.readouterr().err) == is_refused


def test_a_clip_on_any_rig_becomes_one_of_its_actions(imported, tmp_path, voice, capsys):
    """A set of upper-body codes like the published ones: it holds as a whole, and the generator keeps to it."""
    folder = tmp_path / "mine"
    shutil.copytree(imported, folder)
    waving = clip(SCRIPTS["wave"])
    write_bvh(tmp_path / "wave.bvh", waving.skeleton, waving.rotations, waving.root, fps=waving.fps)
    assert main(["actions", "add", "Big wave", str(tmp_path / "wave.bvh"), "--model", str(folder)]) == 0
    mine = load_bundle(folder)
    added = mine.actions["big_wave"]
    assert added.is_set
    assert added.seconds == pytest.approx(waving.seconds, abs=0.14)
    assert added.overlay is None
    drawn = []
    pipeline = Pipeline(mine)
    decode = pipeline.decoder.step
    pipeline.decoder.step = lambda codes, *rest: (drawn.append(codes), decode(codes, *rest))[1]
    with Engine(pipeline).open() as session:
        session.act("big wave")
        session.push(voice[:12_800])
        list(session)
    assert set(np.concatenate(drawn)[..., 1, 0].flatten().tolist()) <= set(added.codes)
    assert main(["actions", "remove", "stand", "--model", str(folder)]) == 0  # code 495 of the lower body is one
    capsys.readouterr()
    assert main(["actions", "list", "--model", str(folder)]) == 0
    assert "3 actions" in capsys.readouterr().out
    assert main(["actions", "build", "--model", str(folder)]) == 1
    assert "add clips one by one" in capsys.readouterr().err
