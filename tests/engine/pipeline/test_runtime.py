"""How a bundle wants to be run travels beside its checkpoints."""

import pytest

from echoavatar.engine.pipeline import Pipeline, load_bundle
from echoavatar.engine.pipeline.runtime import Runtime
from echoavatar.errors import CheckpointError
from echoavatar.motion.stages.post import SWITCHES


def test_without_the_file_everything_is_as_ours(tmp_path):
    assert Runtime.load(tmp_path) == Runtime()
    assert Runtime().stages == ("warp", *SWITCHES)


def test_it_comes_back(tmp_path):
    own = Runtime(level_control=False, silent_temperature=1.0, lead_in_s=0.5, stages=("smoother",))
    own.save(tmp_path)
    assert Runtime.load(tmp_path) == own


def test_the_pipeline_obeys(tiny_bundle):
    from dataclasses import replace

    bundle = replace(load_bundle(tiny_bundle), runtime=Runtime(level_control=False, stages=("smoother",)))
    assert Pipeline(bundle).level is None
    assert Pipeline(bundle).post.stages == {"smoother"}
    assert Pipeline(bundle, stages=("feet",)).post.stages == {"feet"}


def test_a_damaged_file_is_named(tmp_path):
    (tmp_path / "runtime.json").write_text('{"level_control": 3.5}')
    with pytest.raises(CheckpointError, match=r"runtime\.json: level_control"):
        Runtime.load(tmp_path)
