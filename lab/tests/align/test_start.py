"""From folders to a tuned generator that a bundle can take."""

import json
from pathlib import Path

import av
import pytest
from lab.tests.align.moving_bodies import reference_statistics
from lab.tests.align.tuning_fakes import save_clips

from echoavatar.errors import CheckpointError, MotionError
from echoavatar_lab.align.start import load_setup, make_pairs, training_task, tune
from echoavatar_lab.align.trainer import recipe
from echoavatar_lab.models.generator.model import Generator
from echoavatar_lab.models.generator.windows import TokenClip


@pytest.fixture
def tokens(tmp_path: Path) -> Path:
    reference_statistics().save(tmp_path / "reference_statistics.json")
    return save_clips(tmp_path / "tokens", 4, 8, held_out=True)


def ready(tokens: Path, bundle: Path, **changes):
    known = {"bundle": bundle, "reference_statistics": tokens.parent / "reference_statistics.json"} | changes
    return load_setup(tokens, tokens.parent / "run", **known)


@pytest.mark.parametrize("method", ["grpo", "ppo", "dpo"])
def test_each_method_leaves_a_generator_with_the_sampling_it_was_tuned_for(tokens, tiny_bundle, method):
    folder = tokens.parent / "run"
    one = ready(tokens, tiny_bundle, sampling={"temperature": 0.9, "top_p": 0.8})
    pairs = tokens.parent / "pairs.jsonl"
    if method == "dpo":
        sizes = {"past": 1, "length": 1, "group": 4, "fewest_events": 0, "seed": 0}
        assert make_pairs(one, pairs, recipe("tiny", "dpo").model_copy(update=sizes), prompts=3) > 0
    given = pairs if method == "dpo" else None
    tune(training_task(method, recipe("tiny", method), one, pairs=given, command="echoavatar align"), folder)
    tuned = Generator.load(folder)
    assert (tuned.config.temperature, tuned.config.top_p) == (0.9, 0.8)
    card = json.loads((folder / "card.json").read_text())
    assert {"data", "command", "licence", "alignment", "rewards"} <= card.keys()
    lines = [json.loads(line) for line in (folder / "metrics.jsonl").read_text().splitlines()]
    assert [line["step"] for line in lines if "loss" in line] == [1, 2, 3, 4]
    assert {"loss", "kl", "gradient", "rate", "entropy.0", "entropy.1"} <= lines[1].keys()
    measured = {line["step"]: line["held_out"] for line in lines if "held_out" in line}
    assert list(measured) == [0, 2, 4]
    assert {"reward", "rewards", "by_prompt", "kl", "entropy", "fid", "diversity"} <= measured[4].keys()
    assert not (folder / "samples").exists()  # the tiny recipe renders nothing


def test_checkpoints_come_with_videos_of_held_out_prompts(tokens, tiny_bundle):
    folder, training = (tokens.parent / "run", recipe("tiny", "grpo").model_copy(update={"steps": 2, "videos": 1}))
    tune(training_task("grpo", training, ready(tokens, tiny_bundle)), folder)
    with av.open(str(folder / "samples" / "step_000002_0.mp4")) as video:
        assert video.streams.video[0].frames == 16  # a chunk of past and a chunk of its own
        assert video.streams.audio


def test_mismatched_settings_are_refused(tokens, tiny_bundle, tmp_path):
    with pytest.raises(MotionError, match="dpo needs preference pairs"):
        training_task("dpo", recipe("tiny", "dpo"), ready(tokens, tiny_bundle))
    other = Generator(Generator.load(tiny_bundle / "generator").config.model_copy(update={"patience": 0.3}))
    other.save(tmp_path / "other", {})
    with pytest.raises(CheckpointError, match="has another patience"):
        training_task("grpo", recipe("tiny", "grpo"), ready(tokens, tiny_bundle, reference=tmp_path / "other"))


def test_comparisons_of_people_need_no_reference_statistics(tokens, tiny_bundle, tmp_path):
    """A studio's token files hold no true motion, so rewards cannot be measured; DPO does not need them."""
    for path in tokens.glob("*.npz"):
        clip = TokenClip.load(path)
        object.__setattr__(clip, "has_truth", False)
        clip.save(path)
    one = load_setup(tokens, tmp_path / "run", bundle=tiny_bundle, is_compared=True)
    assert one.mix.weights == one.card["rewards"] == {}
    with pytest.raises(MotionError, match="pass the --reference-statistics"):
        load_setup(tokens, tmp_path / "run", bundle=tiny_bundle)
