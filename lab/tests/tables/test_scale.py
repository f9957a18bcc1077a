import pytest
from lab.tests.recipes.test_paper import settings_of

from echoavatar.models.generator import GeneratorConfig
from echoavatar.models.tokenizer_config import MotionTokenizerConfig
from echoavatar_lab.models.generator.train import GeneratorTraining
from echoavatar_lab.tables import main, tokenizer_ablation, user_study
from echoavatar_lab.tables.scale import PAPER, SCALES, TINY, GeneratorChoice


@pytest.mark.parametrize(
    ("stem", "sizes", "training"),
    [
        ("tokenizer", PAPER.tokenizer, PAPER.tokenizer_training.model_copy(update={"evaluate_every": 500})),
        ("generator_stage1", PAPER.generator, PAPER.stage1),
        ("generator_stage2", PAPER.generator, PAPER.generator_training),
        ("generator_stage3", PAPER.generator, PAPER.stage3),
    ],
)
def test_settings_are_those_of_the_recipes(stem: str, sizes, training) -> None:
    """A recipe of the paper is trained with what the tables train with, and takes nothing from the default bundle."""
    found, schedule = settings_of(stem)
    known = found.model_dump(exclude={"features"})
    if stem == "generator_stage3":  # its generator's form is told by its choice
        known |= {name: getattr(sizes, name) for name in ("exemplar", "control", "example_bias")}
    assert known == sizes.model_dump(exclude={"features"})
    assert schedule.model_dump(exclude={"chunks"}) == training.model_dump(exclude={"chunks"})


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
        GeneratorConfig.model_validate(TINY.generator.model_dump() | dict(choice.sizes))
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
