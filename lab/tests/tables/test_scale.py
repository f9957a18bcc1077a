from pathlib import Path

import pytest
import yaml

from echoavatar_lab.tables.scale import PAPER, SCALES

RECIPES = Path(__file__).parents[2] / "recipes"
OWN = {"parts", "log_every", "losses", "depth_weights", "is_principal_start", "is_scaled_by_reach"}


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
