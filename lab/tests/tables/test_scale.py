from pathlib import Path

import pytest
import yaml

from echoavatar.models.tokenizer import MotionTokenizerConfig
from echoavatar_lab.models.generator.train import GeneratorTraining
from echoavatar_lab.tables import main, tokenizer_ablation, user_study
from echoavatar_lab.tables.scale import PAPER, SCALES, TINY, GeneratorChoice, GeneratorSizes

RECIPES = Path(__file__).parents[2] / "recipes"
OWN = {"cooling", "parts", "log_every", "losses", "depth_weights", "is_principal_start", "is_scaled_by_reach"}


@pytest.mark.parametrize(
    ("recipe", "sizes", "training"),
    [
        ("paper/tokenizer", PAPER.tokenizer, PAPER.tokenizer_training),
        ("paper/generator_stage1", PAPER.generator, PAPER.stage1),
        ("paper/generator_stage2", PAPER.generator, PAPER.generator_training),
        ("paper/generator_stage3", PAPER.generator, PAPER.stage3),
    ],
)
def test_settings_are_those_of_the_recipes(recipe: str, sizes, training) -> None:
    """What a recipe says beyond what tables fill in must be the scale's."""
    said = yaml.safe_load((RECIPES / f"{recipe}.yaml").read_text())
    for section, config in (("model", sizes), ("training", training)):
        wanted = {key: value for key, value in said[section].items() if key not in OWN}
        for key in ("exemplar", "control", "example_bias") if section == "model" else ():
            wanted.pop(key, None)  # stage 3's generator is told by its choice
        assert type(config).model_validate(config.model_dump() | wanted) == config


def test_scales_train_without_our_additions() -> None:
    for scale in SCALES.values():
        assert not scale.tokenizer_training.is_principal_start
        losses = scale.tokenizer_training.losses
        assert losses.travel == losses.planted == losses.fingers == losses.root == 0


def test_every_row_departs_in_settings_that_exist() -> None:
    for _, _, tokenizer in tokenizer_ablation.VARIANTS:
        MotionTokenizerConfig.model_validate(TINY.tokenizer.model_dump() | dict(tokenizer.sizes))
    choices = [variant.generator for variant in (*main.VARIANTS, *user_study.VARIANTS)]
    for choice in [*choices, *main.SEQUENCE_ORDERS.values()]:
        GeneratorSizes.model_validate(TINY.generator.model_dump() | dict(choice.sizes))
        GeneratorTraining.model_validate(TINY.generator_training.model_dump() | dict(choice.training))


def test_one_name_is_one_generator() -> None:
    """Tables share parts by name."""
    choices = [v.generator for v in (*main.VARIANTS, *user_study.VARIANTS)]
    choices += main.SEQUENCE_ORDERS.values()
    for one in choices:
        assert all(one == other for other in choices if one.name == other.name)


def test_generators_go_on_along_the_curriculum() -> None:
    second = GeneratorChoice("second", sizes={"sequence": "prefix", "width": 8}, only="speech")
    third = GeneratorChoice("third", after=second)
    assert (third.stage, third.before) == (3, second)
    first = second.before
    assert first == GeneratorChoice(
        "body-parts-prefix-speech", sizes={"sequence": "prefix"}, only="speech", is_first=True
    )
    assert (second.stage, first.stage, first.before) == (2, 1, None)
