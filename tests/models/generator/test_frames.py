"""The generator without torch draws what the one of torch draws, from the same weights."""

import numpy as np
import pytest
import torch
from tests.models.generator.tiny import audio, generator

from echoavatar.errors import CheckpointError
from echoavatar.models.generator.frames import FrameStream
from echoavatar.models.generator.frozen import shapes
from echoavatar.stored import Rounded, read_arrays
from echoavatar_lab.models.generator.model import Generator
from echoavatar_lab.models.generator.stream import open_stream

BOTH = np.ones(2, np.bool_)


def arrays(model: Generator) -> dict[str, np.ndarray]:
    return {name: weight.numpy() for name, weight in model.state_dict().items()}


@pytest.mark.parametrize("precision", ["float32", "int8"])
@pytest.mark.parametrize("is_steered", [False, True])
def test_the_same_codes_as_in_torch(precision, is_steered):
    """Three chunks, two seeds, temperature and nucleus on; sets, their bias and manners change what is drawn."""
    model = generator(sequence="depth", exemplar=True, manner=True, temperature=0.7, cooling=0.8, top_p=0.9)
    x, members = audio(2, 60), torch.zeros(2, 8)
    members[0, [1, 5]] = members[1, 2] = 1
    manner = torch.rand(2, 13, generator=torch.Generator().manual_seed(1))
    manner[1, 3] = torch.nan
    told = {"exemplar": members, "bias": 3 * members, "manner": manner} if is_steered else {}
    one, other = open_stream(model, precision), FrameStream(model.config, arrays(model), rounds=precision == "int8")
    seeds, state = torch.tensor([3, -4]), other.init_state(2)
    wanted = one.step(x, one.init_state(2), torch.ones(2, dtype=torch.bool), seeds=seeds, **told).numpy()
    given = {name: value.numpy() for name, value in told.items()}
    drawn = [other.step(part.numpy(), state, BOTH, seeds=seeds.numpy(), **given) for part in x.split(20, 1)]
    np.testing.assert_array_equal(np.concatenate(drawn, 1), wanted)
    assert len(np.unique(wanted)) > 4


def test_steps_of_one_token_draw_the_same_codes():
    """In torch and without: the seed and the token's place say what is drawn, so a bundle's chunk may be either."""
    whole, half = generator(sequence="depth"), generator(sequence="depth", step=1)
    x, told = audio(1, 60), {"seeds": torch.tensor([4])}
    wanted, again = (
        stream.step(x, stream.init_state(1), torch.ones(1, dtype=torch.bool), **told)
        for stream in (open_stream(whole), open_stream(half))
    )
    np.testing.assert_array_equal(again, wanted)
    frames = FrameStream(half.config, arrays(half), rounds=False)
    state, parts = frames.init_state(1), x.split(10, 1)
    drawn = [frames.step(part.numpy(), state, np.ones(1, np.bool_), seeds=np.array([4])) for part in parts]
    np.testing.assert_array_equal(np.concatenate(drawn, 1), wanted)


@pytest.mark.parametrize("told", [{}, {"exemplar": True}, {"manner": True}])
def test_weights_that_do_not_fit_are_named(told):
    """The compiled loop looks at no bounds."""
    model = generator(sequence="depth", **told)
    assert shapes(model.config) == {name: tuple(weight.shape) for name, weight in model.state_dict().items()}
    short = arrays(model)
    short["model.layers.0.mlp.up_proj.weight"] = short["model.layers.0.mlp.up_proj.weight"][:-1]
    del short["depth.condition.weight"]
    with pytest.raises(CheckpointError, match=r"missing depth\.condition\.weight; model\.layers\.0\.mlp\.up_proj"):
        FrameStream(model.config, short)


def test_without_warmth_the_likeliest_code_is_taken():
    model, x = generator(sequence="depth", temperature=0), audio(1, 40)
    stream, one = open_stream(model), np.ones(1, np.bool_)
    frames = FrameStream(model.config, arrays(model), rounds=False)
    drawn = [frames.step(x.numpy(), frames.init_state(1), one, seeds=np.array([seed])) for seed in (1, 2)]
    np.testing.assert_array_equal(*drawn)
    np.testing.assert_array_equal(drawn[0], stream(x).numpy())


def test_a_row_alone_draws_what_it_draws_in_company_and_rests_as_it_is():
    model, x, seeds = generator(sequence="depth"), audio(3, 80).numpy(), np.array([5, 6, 7])
    stream = FrameStream(model.config, arrays(model))
    state = stream.init_state(3)
    together = [stream.step(x[:, :40], state, np.array([True, True, False]), seeds=seeds)]
    together += [stream.step(x[:, 40:], state, np.array([False, True, True]), seeds=seeds)]
    alone = stream.step(x[1:2], stream.init_state(1), np.ones(1, np.bool_), seeds=seeds[1:2])
    np.testing.assert_array_equal(np.concatenate(together, 1)[1:2], alone)
    fresh = stream.step(x[2:, 40:], stream.init_state(1), np.ones(1, np.bool_), seeds=seeds[2:])
    np.testing.assert_array_equal(together[1][2:], fresh)


def test_a_checkpoint_in_int8_is_read_as_it_is_stored(tmp_path):
    model, x = generator(sequence="depth", exemplar=True), audio(2, 60)
    model.save(tmp_path, {}, dtype=torch.int8)
    stored, loaded = read_arrays(tmp_path), open_stream(Generator.load(tmp_path).eval(), "int8")
    assert isinstance(stored["depth.condition.weight"], Rounded)
    frames = FrameStream(model.config, stored)
    drawn = frames.step(x.numpy(), frames.init_state(2), BOTH)
    np.testing.assert_array_equal(drawn, loaded(x).numpy())
