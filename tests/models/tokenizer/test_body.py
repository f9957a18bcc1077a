import pytest
import torch
from pydantic import ValidationError
from tests.models.tokenizer.fixtures import dance, small_body, small_config

from echoavatar.checkpoint import read_card
from echoavatar.errors import CheckpointError
from echoavatar.models.tokenizer import BodyTokenizer, BodyTokenizerConfig
from echoavatar.motion.kinematics import HUMANOID
from echoavatar_lab.models.tokenizer.windows import clip_features


def codes(rows: int, length: int, generator: torch.Generator) -> torch.Tensor:
    return torch.randint(0, 16, (rows, length, 3, 2), generator=generator)


def frames(rows: int, length: int, generator: torch.Generator) -> torch.Tensor:
    return torch.randn(rows, length, 315, generator=generator, dtype=torch.double)


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
