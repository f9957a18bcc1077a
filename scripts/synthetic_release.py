"""A folder that looks like the authors' release and holds random numbers: to try the importer without their files.

    python scripts/synthetic_release.py OUT              full size (2 GB)
    python scripts/synthetic_release.py OUT --size small a few MB, for tests

Names, shapes and file formats are those of the published files; the skeleton is our own character's, cut into their 88
joints. OUT gets ckpts/, stats/, scripts/ (with a made-up table of actions) and encodec/ (an untrained EnCodec).
"""

import argparse
import json
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from safetensors.torch import save_file

from echoavatar.models.face import HubertConfig
from echoavatar.models.generator import GeneratorConfig
from echoavatar.models.tokenizer_config import MotionTokenizerConfig
from echoavatar.motion.kinematics import HUMANOID
from echoavatar_lab.reference.expected_tensors import Shapes, face_shapes, generator_shapes, tokenizer_shapes
from echoavatar_lab.reference.release_rig import AXES, bones_by_name
from echoavatar_lab.reference.weights import REFERENCE_LAYOUT

FEATURES = {"lower": 117, "upper": 162, "hands": 252}
STEPS = {"lower": 65_000, "upper": 54_000, "hands": 60_000}
LOSSES = "commit-0.5_loss-pos-l1-0.02_loss-pos-vel-l1-0.2_loss-pos-acc-l1-0.2_loss-trans-vel-l1_smooth-10_depth-3"
TOKENIZER = (
    "RVQVAE_PoolingMLP_bp_{part}_nb-code_512_" + LOSSES + "_loss-foot-contact-label-l1-0.3_loss-foot-pos-l1-0.05"
    "_dropout-0_num_quantizers-6_lookback-15/net_{step}.pth"
)
FACE = (
    "llf_v3_FaceGPT_CE_audio_norm_dit_flowmatching_mhubert_augment_ws-64_layers-6_heads-8_feat-512_bs-128"
    "_diffusion-layers-3_hidden-size-64/gpt_80000.pth"
)
ACTIONS = {"idle": [3, 5], "wave": [100, 200, 300], "stand": [7, 9]}


class Size(NamedTuple):
    """What is made small for tests; the vocabulary and all counts of codes stay."""

    width: int
    generator: dict[str, int]
    ear: HubertConfig
    codec: dict[str, object]


SIZES = {
    "full": Size(512, {"width": 896, "layers": 24, "heads": 14, "kv_heads": 2, "mlp": 4864}, HubertConfig(), {}),
    "small": Size(
        16,
        {"width": 16, "layers": 2, "heads": 2, "kv_heads": 1, "mlp": 32},
        HubertConfig(width=64, layers=1, heads=1, mlp=32, convolutions=(8,) * 7, position_kernel=8, position_groups=4),
        {"num_filters": 2, "hidden_size": 8},
    ),
}


def make(out: Path, size: str = "full", seed: int = 0) -> Path:
    """Write the folder and return it."""
    own, random = SIZES[size], torch.Generator().manual_seed(seed)
    for part, features in FEATURES.items():
        config = MotionTokenizerConfig(features=features, width=own.width)
        path = out / "ckpts/body_rvqvae" / TOKENIZER.format(part=part, step=STEPS[part])
        _save(path, "net", _draw(tokenizer_shapes(config), random))
    face = _draw(face_shapes(64, 52, own.ear), random)
    _save(out / "ckpts/face" / FACE, "gpt", face)
    for name in ("body_g", "body_g_d"):
        _write_generator(out / "ckpts" / name, own, random)
    _write_stats(out / "stats", random)
    _write_actions(out / "scripts")
    _write_codec(out / "encodec", own, random)
    return out


def _draw(shapes: Shapes, random: torch.Generator) -> dict[str, torch.Tensor]:
    """Weights that keep the size of what goes through them."""
    weights = {}
    for key, shape in shapes.items():
        if len(shape) == 1 and key.endswith("weight"):
            weights[key] = 1 + 0.1 * torch.rand(shape, generator=random)
        elif len(shape) <= 1:
            weights[key] = 0.05 * torch.randn(shape, generator=random)
        else:
            inputs = float(np.prod(shape[1:]))
            weights[key] = torch.randn(shape, generator=random) * (1.0 if "codebook" in key else inputs**-0.5)
    return weights


def _save(path: Path, key: str, weights: dict[str, torch.Tensor]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    torch.save({key: weights}, path)


def _write_generator(folder: Path, size: Size, random: torch.Generator) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    config = GeneratorConfig.model_validate(
        {"layout": REFERENCE_LAYOUT, "sequence": "prefix", "rope_theta": 1e6, **size.generator}
    )
    weights = {key: value.bfloat16() for key, value in _draw(generator_shapes(config), random).items()}
    save_file(weights, folder / "model.safetensors", metadata={"format": "pt"})
    theirs = {
        "architectures": ["Qwen2ForCausalLM"],
        "hidden_size": config.width,
        "intermediate_size": config.mlp,
        "num_attention_heads": config.heads,
        "num_hidden_layers": config.layers,
        "num_key_value_heads": config.kv_heads,
        "rms_norm_eps": 1e-6,
        "rope_theta": 1e6,
        "tie_word_embeddings": False,
        "vocab_size": REFERENCE_LAYOUT.vocabulary,
    }
    (folder / "config.json").write_text(json.dumps(theirs, indent=1))


def skeleton() -> tuple[list[str], list[int], np.ndarray]:
    """The 88 joints with our character's proportions: names, parents, offsets in centimetres, Z up, facing -Y."""
    bone = {name: own for own, name in bones_by_name().items()}
    names, parents, places = list[str](), list[int](), list[np.ndarray]()
    rest = HUMANOID.rest_positions @ np.array(AXES) * 100  # rows times A is A^-1 applied

    def add(name: str, parent: str | None, at: np.ndarray | None = None) -> None:
        names.append(name)
        parents.append(-1 if parent is None else names.index(parent))
        places.append(rest[HUMANOID.index(bone[name])] if at is None else at)

    def place(name: str) -> np.ndarray:
        return places[names.index(name)]

    def between(name: str, first: str, second: str) -> None:
        add(name, first, (place(first) + rest[HUMANOID.index(bone[second])]) / 2)

    def leg(side: str) -> None:
        add(f"Hip_{side}", "Root_M")
        between(f"HipPart1_{side}", f"Hip_{side}", f"Knee_{side}")
        add(f"Knee_{side}", f"HipPart1_{side}")
        between(f"KneePart1_{side}", f"Knee_{side}", f"Ankle_{side}")
        add(f"Ankle_{side}", f"KneePart1_{side}")
        add(f"Toes_{side}", f"Ankle_{side}")
        add(f"ToesEnd_{side}", f"Toes_{side}", place(f"Toes_{side}") + np.array([0, -6.5, 0]))
        add(f"Heel_{side}", f"Ankle_{side}", place(f"Ankle_{side}"))
        add(f"HeelEnd_{side}", f"Heel_{side}", place(f"Ankle_{side}") + np.array([0, 5.0, -6.0]))

    def finger(digit: str, side: str, parent: str) -> None:
        for k in (1, 2, 3):
            add(f"{digit}Finger{k}_{side}", parent if k == 1 else f"{digit}Finger{k - 1}_{side}")
        last, before = place(f"{digit}Finger3_{side}"), place(f"{digit}Finger2_{side}")
        add(f"{digit}Finger4_{side}", f"{digit}Finger3_{side}", 2 * last - before)

    def arm(side: str) -> None:
        add(f"Scapula_{side}", "Chest_M")
        add(f"Shoulder_{side}", f"Scapula_{side}")
        between(f"ShoulderPart1_{side}", f"Shoulder_{side}", f"Elbow_{side}")
        add(f"Elbow_{side}", f"ShoulderPart1_{side}")
        between(f"ElbowPart1_{side}", f"Elbow_{side}", f"Wrist_{side}")
        add(f"Wrist_{side}", f"ElbowPart1_{side}")
        for digit in ("Middle", "Thumb", "Index"):
            finger(digit, side, f"Wrist_{side}")
        add(f"Cup_{side}", f"Wrist_{side}", place(f"Wrist_{side}"))
        for digit in ("Pinky", "Ring"):
            finger(digit, side, f"Cup_{side}")

    add("Root_M", None)
    leg("R")
    for name, parent in (("Spine1_M", "Root_M"), ("Spine1Part1_M", "Spine1_M"), ("Chest_M", "Spine1Part1_M")):
        add(name, parent)
    arm("R")
    add("Neck_M", "Chest_M")
    between("NeckPart1_M", "Neck_M", "Head_M")
    add("Head_M", "NeckPart1_M")
    add("Head_angleFix", "Head_M", place("Head_M"))
    for side, x in (("L", 3.2), ("R", -3.2)):
        at = place("Head_M") + np.array([x, -8.0, 6.0])
        add(f"{side}_eye_jnt", "Head_angleFix", at)
        add(f"{side}_eScale_jnt", f"{side}_eye_jnt", at)
        add(f"Eye_{side}", f"{side}_eScale_jnt", at)
        add(f"{side}_pupil_jnt", f"Eye_{side}", at + np.array([0, -1.2, 0]))
    arm("L")
    leg("L")
    world = np.array(places)
    offsets = world - np.where(np.array(parents)[:, None] < 0, 0, world[parents])
    return names, parents, offsets.astype(np.float32)


def _write_stats(folder: Path, random: torch.Generator) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    names, parents, offsets = skeleton()
    np.savez(folder / "zm_meta_info.npz", names=np.array(names), parents=np.array(parents, np.int32), offsets=offsets)
    body = np.zeros((2, 6 * len(names) + 3), np.float32)
    body[0, : 6 * len(names)] = np.tile([1, 0, 0, 0, 1, 0], len(names))
    body[0, -1] = offsets[0, 2]
    body[1] = 0.05
    body[1, -3:] = (0.7, 0.7, 2.0)
    for joint, name in enumerate(names):
        if name.endswith(("4_R", "4_L", "jnt")) or name.startswith(("Cup", "Heel", "ToesEnd", "Head_angleFix")):
            body[1, 6 * joint : 6 * joint + 6] = 3e-6 if joint % 2 else 0.0
    np.save(folder / "body_mean_std_30fps.npy", body)
    mean = 0.2 * torch.rand(52, generator=random).numpy()
    std = 0.05 + 0.1 * torch.rand(52, generator=random).numpy()
    mean[[3, 6, 11, 13]], std[[3, 6, 11, 13]] = 0, 1e-5
    table = np.array({"mean": mean.astype(np.float32), "std": std.astype(np.float32)}, dtype=object)
    np.save(folder / "arkit_mean_std_30fps.npy", table, allow_pickle=True)
    turns, _ = np.linalg.qr(torch.randn(len(names), 3, 3, generator=random).double().numpy())
    turns *= np.linalg.det(turns)[:, None, None]
    flip = np.diag([-1.0, 1.0, 1.0])
    for file, own in (("magic_rest_matrices.json", turns), ("magic_transforms.json", flip @ turns)):
        matrices = dict[str, list[list[float]]]()
        for name, matrix in zip(names, own, strict=True):
            full = np.eye(4)
            full[:3, :3] = matrix
            matrices[name] = full.tolist()
        (folder / file).write_text(json.dumps(matrices))


def _write_actions(folder: Path) -> None:
    """As a script writes it: a dictionary among other code, lower-body codes as code - 512 * 6."""
    folder.mkdir(parents=True, exist_ok=True)
    rows = [f"    {name!r}: {codes}," for name, codes in ACTIONS.items()]
    rows[-1] = rows[-1].replace("]", ", 495 - 512 * 6]")
    text = "raise SystemExit('never run')\ntable = {\n" + "\n".join(rows) + "\n}\n"
    (folder / "5_streaming.py").write_text(text)


def _write_codec(folder: Path, size: Size, random: torch.Generator) -> None:
    from transformers import EncodecConfig, EncodecModel

    torch.manual_seed(int(torch.randint(1 << 30, (), generator=random)))
    EncodecModel(EncodecConfig(**size.codec)).save_pretrained(folder)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--size", choices=tuple(SIZES), default="full")
    chosen = parser.parse_args()
    print(make(chosen.out, chosen.size))
