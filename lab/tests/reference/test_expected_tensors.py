"""Names and shapes of the published files, against what was recorded of them."""

import json

import numpy as np
import pytest
import torch
from safetensors.torch import load_file
from tests import golden as fixtures
from tests.golden import golden
from tests.parity.test_reference_tokenizer import procedural

from echoavatar.models.face import HubertConfig
from echoavatar.models.face.noise import euler_levels
from echoavatar_lab.checkpoint import load_into
from echoavatar_lab.models.face.encoder import normalize_window, pad_window
from echoavatar_lab.models.face.gpt import rotate_pairs, sinusoids
from echoavatar_lab.models.face.model import FaceModel
from echoavatar_lab.models.face.train import paper_face
from echoavatar_lab.models.face.window import WindowFrames
from echoavatar_lab.models.tokenizer.model import MotionTokenizerConfig
from echoavatar_lab.reference.expected_tensors import (
    differences,
    face_shapes,
    from_reference,
    hubert_of,
    tokenizer_shapes,
)

HUBERT = HubertConfig(
    width=48, layers=2, heads=4, mlp=96, convolutions=(24,) * 7, position_kernel=16, position_groups=4
)


def test_the_face_has_the_152_recorded_tensors_beside_its_ear():
    recorded = json.loads(fixtures.golden("reference_release/face_state_keys.json").read_text())
    own = {
        key: list(shape) for key, shape in face_shapes(64, 52, HUBERT).items() if not key.startswith("audio_encoder")
    }
    assert own == {key: shape for key, (shape, _, _) in recorded.items()}
    assert len(own) == 152


def test_a_tokenizer_has_92_tensors_and_the_published_size():
    shapes = tokenizer_shapes(MotionTokenizerConfig(features=117))
    assert len(shapes) == 92
    assert shapes["encoder.0.attn.qkv.weight"] == (1536, 512)
    assert shapes["quantizer.layers.5.codebook"] == (512, 512)
    assert sum(rows * columns[0] if columns else rows for rows, *columns in shapes.values()) == 33_192_565


def test_the_ears_sizes_are_told_by_its_tensors():
    found = hubert_of(face_shapes(64, 52, HUBERT))
    assert found == HUBERT.model_copy(update={"heads": 1})
    assert hubert_of(face_shapes(64, 52, HubertConfig())) == HubertConfig()


def test_every_difference_is_listed():
    wanted = {"a": (1, 2), "b": (3,), "c": (4,), "masked_spec_embed": (4,)}
    assert differences(wanted, wanted, origin="f") == []
    assert differences({"a": (1, 2), "b": (5,), "d": (1,)}, wanted, origin="f") == [
        "f: c [4] is missing",
        "f: d [1] is unknown",
        "f: b is [5], wanted [3]",
    ]


def arrays(name: str) -> dict[str, torch.Tensor]:
    return {key: torch.from_numpy(value) for key, value in np.load(golden(f"reference_release/{name}")).items()}


@pytest.fixture(scope="module")
def parts() -> dict[str, torch.Tensor]:
    return arrays("face_parts.npz")


@pytest.fixture(scope="module")
def model() -> FaceModel:
    ear = HubertConfig(
        width=48, layers=2, heads=4, mlp=96, convolutions=(24,) * 7, position_kernel=16, position_groups=4
    )
    face = FaceModel(paper_face(width=64, encoder=ear))
    keys = json.loads(golden("reference_release/face_state_keys.json").read_text())
    theirs = procedural({key: tuple(shape) for key, (shape, _, kind) in keys.items() if kind == "param"}, 4001)
    ears = load_file(golden("reference_release/face_tiny_hubert.safetensors"))
    weights = from_reference(theirs | {f"audio_encoder.{key}": value for key, value in ears.items()})
    load_into(face, weights | {"mean": face.mean, "std": face.std}, origin="the reference")
    return face.eval()


def near(ours: torch.Tensor, theirs: torch.Tensor, atol: float = 1e-5) -> None:
    torch.testing.assert_close(ours, theirs, atol=atol, rtol=0)


def test_names_of_the_release_are_all_known():
    keys = json.loads(golden("reference_release/face_state_keys.json").read_text())
    theirs = {key for key, (_, _, kind) in keys.items() if kind == "param"}
    ours = from_reference({key: torch.zeros(1) for key in keys})
    # past_proj and anchor_proj have no use; the steering of three blocks becomes one matrix
    assert len(ours) == len(theirs) - 4 - 2 * 4


@torch.no_grad()
def test_time_and_head(model, parts):
    near(model.head.sinusoids(parts["t"]), parts["t_sin"], 3e-5)  # float32 angles of up to 1000
    near(model.head.embed_time(parts["t"]), parts["t_emb"])
    times = torch.full((2, 1), 500)
    near(model.head(parts["dh_latent"], times, parts["dh_gpt"]), parts["dh_out_t500"])


@torch.no_grad()
def test_block_and_its_parts(model, parts):
    x, block = parts["blk_x"], model.gpt.blocks[0]
    near(rotate_pairs(x, 0), parts["rope_out"])
    near(x + sinusoids(x, 0), parts["pe_out"])
    near(block.attn1(x), parts["selfattn_rope_out"])
    near(block.attn2(x), parts["selfattn_pos_out"])
    near(block(x, parts["blk_audio"]), parts["blk_out"])


@torch.no_grad()
def test_hubert(model, parts):
    near(normalize_window(parts["audio_raw"]), parts["audio_norm"])
    near(model.encoder.hubert(parts["audio_norm"]).last_hidden_state, parts["hubert_hidden"], 1e-4)
    features = model.gpt.sound_proj(model.encoder.window(parts["audio_raw"]))
    near(features, parts["audio_feat63"], 1e-4)


def test_padding(parts):
    for length in (33579, 33600, 16000, 16100, 33280, 33360):
        assert pad_window(torch.zeros(1, length)).shape[1] == parts[f"padlen_{length}"]
    assert torch.equal(pad_window(parts["pad_in_1000"]), parts["pad_out_1000"])


def test_schedule(parts):
    for steps in (1, 3, 5):
        times, levels = euler_levels(steps)
        near(torch.tensor(times), parts[f"timesteps_{steps}"], 1e-3)
        near(torch.tensor(levels), parts[f"sigmas_{steps}"])


@torch.no_grad()
def test_eight_frames(model):
    """One chunk from a filled history: 56 frames of motion, 63 of sound, one draw of noise per frame."""
    golden = arrays("face_infer_8.npz")
    window = WindowFrames(model)
    state = window.init_state(1)
    state.motion.copy_(golden["pre_motion"][None])
    projection, model.gpt.sound_proj = model.gpt.sound_proj, torch.nn.Identity()
    try:
        state.sound = torch.zeros(1, 55, 64)
        noise = golden["noise"][:, 0].transpose(0, 1)
        frames = window.step(golden["audio_feat"], state, torch.ones(1, dtype=torch.bool), noise)
    finally:
        model.gpt.sound_proj = projection
    near(frames[0], golden["out_norm"], 2e-4)  # rounding grows over frames that feed on each other
    assert torch.equal(state.motion[0, -8:], frames[0])
    assert torch.equal(state.motion[0, :-8], golden["pre_motion"][8:])
