import json
import re
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from echoavatar.cli.options import WITHOUT_HELP
from echoavatar.engine.pipeline import Pipeline, load_bundle
from echoavatar.engine.pipeline.action_making import action_from_motion
from echoavatar.engine.pipeline.bundle import OPTIONAL_STAGES, with_random_generator
from echoavatar.errors import CheckpointError, EchoAvatarError, MotionError
from echoavatar.motion.kinematics import Motion, to_features
from echoavatar.motion.stages.post import SWITCHES
from echoavatar_lab.corpora.rehearsal.own_actions import own_actions
from echoavatar_lab.evaluation.batch import animate_many
from echoavatar_lab.models.generator.model import Generator
from echoavatar_lab.models.generator.sequences import compact_layout
from echoavatar_lab.models.tokenizer.model import BodyTokenizer
from echoavatar_lab.models.tokenizer.train import as_one_part, body_config


def test_a_bundle_loads_with_its_parts_fitting(tiny_bundle: Path) -> None:
    bundle = load_bundle(tiny_bundle)
    assert bundle.skeleton.joints == 52
    assert bundle.generator.config.layout.motion_layers == bundle.tokenizer.config.layers == 2
    assert bundle.parameters > 1000


def test_stages_are_left_out_and_one_that_is_none_is_named() -> None:
    whole = load_bundle()
    part = whole.without(["face", "smoother"])
    assert part.face is None
    assert Pipeline(part).post.stages == {"stillness", "ground", "leash", "feet", "hands"}
    assert whole.face is not None  # the one it was taken from is as it was
    assert Pipeline(whole.without([])).post.stages == set(SWITCHES)
    with pytest.raises(EchoAvatarError, match="no stage 'toes' to switch on or off; there are face, smoother"):
        whole.without(["smoother", "toes"])


def test_help_names_every_stage_that_can_be_left_out() -> None:
    assert set(OPTIONAL_STAGES) <= set(re.findall(r"\w+", WITHOUT_HELP))


def test_a_body_of_one_part_animates(tiny_bundle: Path, voice: np.ndarray) -> None:
    """The vocabulary has a third of the segments; nothing behind the tokenizer knows."""
    torch.manual_seed(0)
    shipped = load_bundle(tiny_bundle)
    parted = shipped.tokenizer
    template = next(iter(parted.config.parts.values()))
    whole = BodyTokenizer(body_config(as_one_part(parted.skeleton), template)).eval()
    still = Motion.at_rest(whole.skeleton)
    whole.mean.copy_(torch.from_numpy(to_features(whole.skeleton, still.matrices(), still.root)[0]))
    whole.std.fill_(0.02)
    for name, book in whole.named_buffers():
        if name.endswith("codebook"):
            book.normal_()
    layout = compact_layout(audio_codes=16, motion_layers=2, motion_codes=8, parts=1)
    config = shipped.generator.config.model_copy(update={"layout": layout})
    bundle = replace(shipped.having(tokenizer=whole, generator=Generator(config).eval()), actions=own_actions(whole))
    (done,) = animate_many(Pipeline(bundle), [voice], seeds=[1])
    assert done.motion.frames == 60
    assert np.isfinite(done.motion.rotations).all()
    assert np.abs(np.diff(done.motion.rotations, axis=0)).max() > 1e-4
    with pytest.raises(MotionError, match="upper body"):
        action_from_motion(whole.clips(), "sway", done.motion)


def test_an_unknown_name_lists_what_there_is() -> None:
    with pytest.raises(CheckpointError, match="no bundle 'nonsense'"):
        load_bundle("nonsense")


def test_a_missing_part_is_named(tiny_bundle: Path, tmp_path: Path) -> None:
    shutil.copytree(tiny_bundle, tmp_path / "b")
    shutil.rmtree(tmp_path / "b" / "codec")
    with pytest.raises(CheckpointError, match="codec missing"):
        load_bundle(tmp_path / "b")


def test_parts_that_do_not_speak_the_same_codes_are_refused(tiny_bundle: Path, tmp_path: Path) -> None:
    folder = tmp_path / "b"
    shutil.copytree(tiny_bundle, folder)
    config = json.loads((folder / "generator" / "config.json").read_text())
    from echoavatar.models.generator import GeneratorConfig

    layout = compact_layout(audio_codes=32, motion_layers=2, motion_codes=8)
    Generator(GeneratorConfig(**(config | {"layout": layout}))).save(folder / "generator", {})
    with pytest.raises(CheckpointError, match="32 audio codes, the other part 16"):
        load_bundle(folder)


def test_a_generator_that_hears_ahead_is_refused_by_name(tiny_bundle: Path, tmp_path: Path) -> None:
    folder = tmp_path / "early"
    shutil.copytree(tiny_bundle, folder)
    shipped = load_bundle(tiny_bundle)
    config = shipped.generator.config.model_copy(update={"ahead_chunks": 2})
    Generator(config).save(folder / "generator", {})
    with pytest.raises(CheckpointError, match=r"early: its generator hears the sound 2 chunks \(0\.53 s\) before"):
        load_bundle(folder)


@pytest.mark.parametrize("sequence", ["prefix", "interleaved", "depth"])
def test_a_generator_of_the_papers_size_has_any_order_and_no_lead_in(tiny_bundle: Path, sequence: Any) -> None:
    bundle = load_bundle(tiny_bundle)
    loaded = {"codec": bundle.codec, "tokenizer": bundle.tokenizer}  # before parts without memory are asked for
    with torch.device("meta"):
        large = with_random_generator(bundle, sequence)
    assert large.generator.config.sequence == sequence
    assert large.runtime.lead_in_s == 0
    assert {name: large.parts[name].module for name in loaded} == loaded
    assert large.generator.config.layout == bundle.generator.config.layout
