from echoavatar.models.tokenizer import MotionTokenizerConfig
from echoavatar_lab.models.generator.train import GeneratorTraining
from echoavatar_lab.tables import dataset_composition, layouts, main, tokenizer_ablation
from echoavatar_lab.tables.scale import TINY, GeneratorSizes


def test_every_row_departs_in_settings_that_exist() -> None:
    for variant in tokenizer_ablation.VARIANTS:
        MotionTokenizerConfig.model_validate(TINY.tokenizer.model_dump() | dict(variant.tokenizer.sizes))
    choices = [variant.generator for variant in (*main.VARIANTS, *dataset_composition.VARIANTS)]
    for choice in [*choices, *layouts.VARIANTS.values()]:
        GeneratorSizes.model_validate(TINY.generator.model_dump() | dict(choice.sizes))
        GeneratorTraining.model_validate(TINY.generator_training.model_dump() | dict(choice.training))


def test_one_name_is_one_generator() -> None:
    """Tables share parts by name."""
    choices = [v.generator for v in (*main.VARIANTS, *dataset_composition.VARIANTS)]
    choices += layouts.VARIANTS.values()
    for one in choices:
        assert all(one == other for other in choices if one.name == other.name)
