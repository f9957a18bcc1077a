import pytest

from echoavatar.models.tokenizer import BodyTokenizer
from echoavatar.motion.kinematics import HUMANOID
from echoavatar_lab.models.tokenizer.recipe import TokenizerTraining, bundle_recipe, continued


def test_the_rate_drops_in_steps():
    training = TokenizerTraining(steps=10, learning_rate=1e-3, warmup=2)
    rates = [training.rate_at(step) for step in (0, 1, 4, 5, 8)]
    assert rates == pytest.approx([5e-4, 1e-3, 1e-3, 1e-4, 1e-5])


def test_the_bundle_recipe_fits_the_budget():
    """Three tokenizers in half precision stay under 14 MB."""
    config, training = bundle_recipe(HUMANOID, 1000)
    tensors = BodyTokenizer(config).state_dict().values()
    assert sum(tensor.numel() * 2 for tensor in tensors) < 14e6
    assert training.steps == 1000
    assert config.layers == 4


def test_going_on_from_a_trained_tokenizer_is_gentler():
    _, training = bundle_recipe(HUMANOID, 1000)
    assert continued(training).learning_rate == pytest.approx(0.3 * training.learning_rate)
    assert continued(training).quantize_from == 0
    assert not continued(training).is_principal_start
