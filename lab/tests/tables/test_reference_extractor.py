"""EMAGE's extractor against the released implementation, run with random weights (tests/fixtures/golden)."""

import json
from pathlib import Path

import numpy as np
import torch
from safetensors.torch import save_file
from tests.golden import golden
from tests.parity.test_reference_tokenizer import procedural

from echoavatar_lab.tables.skeleton_convolution import (
    SMPLX_PARENTS,
    SkeletonConvolution,
    SkeletonConvolutionConfig,
    merged,
    skeleton_edges,
)


def stored(name: str) -> dict[str, np.ndarray]:
    return dict(np.load(golden(f"reference_release/{name}")))


def told(name: str) -> dict:
    return json.loads(golden(f"reference_release/{name}").read_text())


def test_bones_and_how_they_merge() -> None:
    golden = told("fid_vaeskconv_topology.json")
    assert tuple(stored("fid_vaeskconv.npz")["smplx_parents"]) == SMPLX_PARENTS
    edges = skeleton_edges(SMPLX_PARENTS)
    for layer in range(4):
        assert [list(edge) for edge in edges] == golden["topologies"][layer]
        groups, edges = merged(edges)
        assert groups == golden["pooling_lists"][layer]


def test_names_shapes_and_masks_of_the_extractor() -> None:
    weights = SkeletonConvolution(SkeletonConvolutionConfig()).state_dict()
    assert {key: list(value.shape) for key, value in weights.items()} == told("fid_vaeskconv_keys.json")["keys"]
    masks = told("fid_vaeskconv_topology.json")["mask_sum"]
    assert {key: int(weights[key].sum()) for key in masks} == masks


@torch.no_grad()
def test_the_extractor_gives_the_released_numbers(tmp_path: Path) -> None:
    golden = {key: torch.from_numpy(value) for key, value in stored("fid_vaeskconv.npz").items()}
    own = SkeletonConvolution(SkeletonConvolutionConfig()).state_dict()
    built = set(told("fid_vaeskconv_keys.json")["not_procedural(topology-derived)"])
    drawn = procedural({key: tuple(own[key].shape) for key in own if key not in built}, 5001)
    prefixed = {f"module.{key}": value for key, value in (own | drawn).items()}
    config = SkeletonConvolutionConfig().model_dump_json()
    (tmp_path / "config.json").write_text(config)
    save_file(prefixed, tmp_path / "model.safetensors")
    model = SkeletonConvolution.load(tmp_path)
    latent = model.encode(golden["x"])
    torch.testing.assert_close(latent, golden["latent"], atol=5e-5, rtol=0)
    torch.testing.assert_close(model.decode(latent), golden["rec"], atol=5e-5, rtol=0)
    torch.testing.assert_close(model.features(golden["x"][0]), golden["latent"][0], atol=5e-5, rtol=0)
