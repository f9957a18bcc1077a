import pytest
import torch
from pydantic import ValidationError
from tests.models.motion_tokens import dance, small_body, small_config

from echoavatar.errors import CheckpointError
from echoavatar.models.tokenizer_config import BodyTokenizerConfig, MotionTokenizerConfig
from echoavatar.motion.kinematics import HUMANOID
from echoavatar.stored import read_card
from echoavatar_lab.models.tokenizer.model import BodyTokenizer, MotionTokenizer, split_parts
from echoavatar_lab.models.tokenizer.train import clip_features


def codes(rows: int, length: int, generator: torch.Generator) -> torch.Tensor:
    return torch.randint(0, 16, (rows, length, 3, 2), generator=generator)


def frames(rows: int, length: int, generator: torch.Generator) -> torch.Tensor:
    return torch.randn(rows, length, 315, generator=generator, dtype=torch.double)


def test_parts_join_to_the_whole():
    features = frames(2, 4, torch.Generator().manual_seed(0))
    parts = split_parts(HUMANOID, features)
    assert list(parts) == ["lower", "upper", "hands"]
    assert torch.equal(torch.cat(list(parts.values()), -1), features)


def test_long_clips_in_pieces_equal_one_pass_of_the_parts():
    """600 frames are cut into pieces of 240; each part, given the whole clip at once, answers the same."""
    body = small_body().double()
    features = frames(1, 600, torch.Generator().manual_seed(0))
    found = body.encode(features)
    assert found.shape == (1, 150, 3, 2)
    normal = body.statistics.normalize(features)
    parts = normal.split([57, 78, 180], -1)
    with torch.no_grad():
        whole = [part.encode(x) for part, x in zip(body.tokenizers().values(), parts, strict=True)]
    assert torch.equal(found, torch.stack(whole, 2))


def test_decoding_undoes_the_normalisation():
    body = small_body()
    with torch.no_grad():
        some = codes(1, 3, torch.Generator().manual_seed(0))
        parts = [part.decode(some[:, :, p]) for p, part in enumerate(body.tokenizers().values())]
    expected = torch.cat(parts, -1) * body.std + body.mean
    torch.testing.assert_close(body.decode(some), expected, atol=1e-5, rtol=1e-5)


def test_each_part_depends_on_its_own_codes_only():
    body = small_body()
    some = codes(1, 3, torch.Generator().manual_seed(0))
    other = some.clone()
    other[:, :, 1] = (other[:, :, 1] + 1) % 16
    changed = (body.decode(some) != body.decode(other)).any(1)[0]
    assert changed.nonzero().flatten().tolist() == list(range(57, 57 + 78))


def test_a_checkpoint_comes_back_whole(tmp_path):
    """Weights are stored in half precision, statistics in full: saving what was loaded changes nothing any more."""
    body = small_body()
    body.save(tmp_path / "a", {"licence": "Apache-2.0"})
    loaded = BodyTokenizer.load(tmp_path / "a")
    loaded.save(tmp_path / "b", {})
    again = BodyTokenizer.load(tmp_path / "b")
    assert torch.equal(loaded.mean, body.mean)
    for mine, theirs in zip(loaded.state_dict().values(), again.state_dict().values(), strict=True):
        assert torch.equal(mine, theirs)
    assert read_card(tmp_path / "a") == {"licence": "Apache-2.0"}
    assert loaded.skeleton.names == HUMANOID.names
    features = clip_features(HUMANOID, dance(0, 64))[None]
    assert torch.equal(loaded.encode(features), again.encode(features))


def test_a_folder_without_weights_is_named(tmp_path):
    with pytest.raises(CheckpointError, match="config.json is missing"):
        BodyTokenizer.load(tmp_path)


def test_parts_must_fit_the_skeleton():
    config = small_config()
    with pytest.raises(ValidationError, match="parts must be those of the skeleton"):
        BodyTokenizerConfig(skeleton=config.skeleton, parts={"lower": config.parts["lower"]})
    uneven = config.parts["upper"].model_copy(update={"layers": 3})
    with pytest.raises(ValidationError, match="same number of layers"):
        BodyTokenizerConfig(skeleton=config.skeleton, parts={**config.parts, "upper": uneven})


CONFIG = MotionTokenizerConfig(features=10, width=16, heads=2, layers=3, codes=24)


@pytest.fixture
def tokenizer() -> MotionTokenizer:
    torch.manual_seed(0)
    model = MotionTokenizer(CONFIG).double()
    for book in model.quantizer.books():
        torch.nn.init.normal_(book.codebook)
    return model.eval()


def frames_model(rows: int, length: int, generator: torch.Generator) -> torch.Tensor:
    return torch.randn(rows, length, 10, generator=generator, dtype=torch.double)


def codes_model(rows: int, length: int, generator: torch.Generator) -> torch.Tensor:
    return torch.randint(0, 24, (rows, length, 3), generator=generator)


def test_a_token_depends_on_45_frames_by_gradient(tokenizer):
    """Token 12 of 15 sees frames_model 4 * 12 - 41 = 7 up to 4 * 12 + 3 = 51."""
    x = frames_model(1, 60, torch.Generator().manual_seed(0)).requires_grad_()
    tokenizer.to_latents(x)[0, 12].sum().backward()
    seen = x.grad[0].abs().sum(-1).nonzero().flatten().tolist()
    assert seen == list(range(7, 52))


def test_a_frame_depends_on_twelve_tokens_by_gradient(tokenizer):
    """Frame 56 (the first of token 14) sees tokens 3..14; 55 (the last of 13) sees 3..13."""
    z = torch.randn(1, 16, 16, dtype=torch.double, requires_grad=True)
    for frame, first, last in ((56, 3, 14), (55, 3, 13)):
        z.grad = None
        tokenizer.from_latents(z)[0, frame].sum().backward()
        seen = z.grad[0].abs().sum(-1).nonzero().flatten().tolist()
        assert seen == list(range(first, last + 1))


def test_trailing_layers_may_be_missing(tokenizer):
    some = codes_model(1, 4, torch.Generator().manual_seed(0))
    masked = some.clone()
    masked[..., 1:] = -1
    torch.testing.assert_close(tokenizer.decode(some[..., :1]), tokenizer.decode(masked))


def test_frames_must_fill_whole_tokens(tokenizer):
    with pytest.raises(ValueError, match="multiple of 4"):
        tokenizer.encode(torch.zeros(1, 6, 10, dtype=torch.double))


def test_lookback_halves_with_the_rate():
    assert [CONFIG.lookback_at(level) for level in range(3)] == [15, 7, 3]


def test_heads_must_divide_the_width():
    with pytest.raises(ValidationError, match="twice the heads"):
        MotionTokenizerConfig(features=4, width=12, heads=4)


def test_without_look_back_a_token_sees_its_own_four_frames_only():
    """So a stream in pieces must give what a whole clip gives."""
    model = MotionTokenizer(CONFIG.model_copy(update={"lookback": 0})).double()
    x = frames_model(1, 32, torch.Generator().manual_seed(0)).requires_grad_()
    model.to_latents(x)[0, 5].sum().backward()
    assert x.grad[0].abs().sum(-1).nonzero().flatten().tolist() == [20, 21, 22, 23]
    state, every = model.init_encoder(1), torch.ones(1, dtype=torch.bool)
    with torch.no_grad():
        pieces = [model.latents_step(piece, state, every) for piece in x.split(12, 1)]
        torch.testing.assert_close(torch.cat(pieces, 1), model.to_latents(x))


def test_a_variant_of_the_ablation_is_refused_with_the_place_where_it_runs():
    for change in ({"blocks": "convolution"}, {"resampling": "learned"}):
        with pytest.raises(ValueError, match="in the ablation alone"):
            MotionTokenizer(CONFIG.model_copy(update=change))
