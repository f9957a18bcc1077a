"""Our metrics against the released implementation's, run with random weights (tests/fixtures/golden)."""

import json

import numpy as np
import pytest
import torch
from tests import golden as fixtures
from tests.parity.test_reference_tokenizer import procedural

from echoavatar.evaluation.metrics.audio_events import EMAGE_RATE_HZ, speech_onsets
from echoavatar.evaluation.metrics.beat_alignment import hit_rate
from echoavatar.evaluation.metrics.diversity import l1_diversity
from echoavatar.evaluation.metrics.frechet import frechet_distance
from echoavatar.evaluation.metrics.gesture_alignment import (
    GESTURE_RULES,
    SMPLX_UPPER_BODY,
    gesture_alignment,
    gesture_beat_frames,
)
from echoavatar.evaluation.metrics.skeleton_convolution import SkeletonConvolution, SkeletonConvolutionConfig
from echoavatar.evaluation.metrics.skeleton_edges import SMPLX_PARENTS, merged, skeleton_edges


def stored(name: str) -> dict[str, np.ndarray]:
    return dict(np.load(fixtures.golden(f"reference_release/{name}")))


def told(name: str) -> dict:
    return json.loads(fixtures.golden(f"reference_release/{name}").read_text())


def test_fid() -> None:
    golden = stored("fid_frechet.npz")
    assert frechet_distance(golden["A"], golden["B"]) == pytest.approx(float(golden["fid"]), rel=1e-6)
    assert frechet_distance(golden["A"], golden["A"]) == pytest.approx(float(golden["fid_self"]), abs=1e-9)


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
def test_the_extractor_gives_the_released_numbers() -> None:
    golden = {key: torch.from_numpy(value) for key, value in stored("fid_vaeskconv.npz").items()}
    own = SkeletonConvolution(SkeletonConvolutionConfig()).state_dict()
    built = set(told("fid_vaeskconv_keys.json")["not_procedural(topology-derived)"])
    drawn = procedural({key: tuple(own[key].shape) for key in own if key not in built}, 5001)
    prefixed = {f"module.{key}": value for key, value in (own | drawn).items()}
    model = SkeletonConvolution.from_weights(prefixed)
    latent = model.encode(golden["x"])
    torch.testing.assert_close(latent, golden["latent"], atol=5e-5, rtol=0)
    torch.testing.assert_close(model.decode(latent), golden["rec"], atol=5e-5, rtol=0)
    torch.testing.assert_close(model.features(golden["x"][0]), golden["latent"][0], atol=5e-5, rtol=0)


@pytest.mark.parametrize("stretch", ["windowed", "full"])
def test_ba_g(stretch: str) -> None:
    """Beats of every joint exactly, the score to 1e-9, and the onsets of the same librosa exactly."""
    golden = stored("metrics_ba_div.npz")
    off = int(golden["align_mask_frames"]) if stretch == "windowed" else 0
    joints = golden["joints"].reshape(-1, 55, 3)
    found = gesture_beat_frames(joints, GESTURE_RULES["emage"], golden["avg_vel"], window=(off, len(joints) - off))
    assert [len(own) for own in found] == golden[f"beats_{stretch}_len"].tolist()
    assert np.array_equal(np.concatenate(found), golden[f"beats_{stretch}"])
    upper = [found[joint] / 30 for joint in SMPLX_UPPER_BODY]
    ours = gesture_alignment(upper, golden[f"onsets_{stretch}"], "emage")
    assert ours == pytest.approx(float(golden[f"align_{stretch}"]), abs=1e-9)


@pytest.mark.parametrize("stretch", ["windowed", "full"])
def test_onsets(stretch: str) -> None:
    pytest.importorskip("librosa")
    golden = stored("metrics_ba_div.npz")
    audio = golden["wav_int16"].astype(np.float32) / 32768
    off = EMAGE_RATE_HZ if stretch == "windowed" else 0
    found = speech_onsets(audio[off : len(audio) - off], EMAGE_RATE_HZ)
    np.testing.assert_array_equal(found, golden[f"onsets_{stretch}"])


def test_hit_rate_and_diversity() -> None:
    golden = stored("metrics_ba_div.npz")
    ours = hit_rate(np.array([0.5, 1, 2.2]), np.array([0.45, 1.4, 3]), 0.3)
    assert ours == pytest.approx(float(golden["gahr_demo"]), abs=1e-9)
    joints = golden["joints"].reshape(-1, 55, 3)
    assert l1_diversity([joints, joints[:120]]) == pytest.approx(float(golden["l1div"]), abs=1e-9)
