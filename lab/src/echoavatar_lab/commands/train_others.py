"""Stages of `echoavatar train` beside the body: the face, the fingers, the extractor of FID.

Without a recipe sizes are those of the default bundle, which are read from it.
"""

import argparse
import logging
from collections.abc import Iterator
from pathlib import Path

import torch
from torch import Tensor
from tqdm import tqdm

from echoavatar.errors import EchoAvatarError, MotionError
from echoavatar.models.face import FaceConfig
from echoavatar.motion.formats import read_bvh
from echoavatar.motion.kinematics import Motion
from echoavatar.stored import read_card
from echoavatar.timing import FRAME_RATE_HZ
from echoavatar_lab.data import Corpus
from echoavatar_lab.evaluation.fingers import measure_fingers
from echoavatar_lab.evaluation.metrics.motion_encoder import MotionEncoder, MotionEncoderConfig, motion_features
from echoavatar_lab.evaluation.metrics.motion_encoder_train import (
    MotionEncoderTask,
    MotionEncoderTraining,
    explained_variance,
)
from echoavatar_lab.models.face.clip import load_clips
from echoavatar_lab.models.face.model import FaceModel
from echoavatar_lab.models.face.train import FaceTask, FaceTraining
from echoavatar_lab.models.fingers.clips import FingerClip, finger_clip
from echoavatar_lab.models.fingers.model import FingerConfig, FingerModel
from echoavatar_lab.models.fingers.train import FingerTask, FingerTraining
from echoavatar_lab.models.published import read_hubert
from echoavatar_lab.training import train

from .recipe import Given, Stage, shipped

_log = logging.getLogger(__name__)


def _add_face(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--start", type=Path, help="trained face model of the same sizes to start from")
    parser.add_argument(
        "--hubert",
        type=Path,
        metavar="FOLDER",
        help="pretrained HuBERT (transformers' config.json and weights) as the encoder, kept as it is; the paper's is "
        "multilingual, with 768 channels. Goes with --recipe lab/recipes/paper/face.yaml",
    )


def _train_face(given: Given) -> None:
    """Train on the face clips."""
    args, settings = given.args, given.settings
    encoder = read_hubert(args.hubert) if args.hubert else None
    if encoder is not None:
        settings.model["encoder"] = encoder.config.model_dump()
    train(
        FaceTask(
            settings.checked(FaceConfig, "model"),
            settings.checked(FaceTraining, "training"),
            load_clips(args.source),
            card=given.card,
            encoder=encoder,
        ),
        args.output,
        start=FaceModel.load(args.start) if args.start else None,
        **given.how,
    )


def _add_fingers(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--recordings", type=Path, help="folder of recorded BVH clips to train on as well")


def _train_fingers(given: Given) -> None:
    """Train, then score the model on the corpus's test clips."""
    args, settings = given.args, given.settings
    config = settings.checked(FingerConfig, "model")
    training = settings.checked(FingerTraining, "training")
    clips = list(_clips(args.source, "train", config.frames))
    recorded = list(_recordings(args.recordings, config.frames)) if args.recordings else []
    train(FingerTask(config, training, clips, recorded, card=given.card), args.output, **given.how)
    model = FingerModel.load(args.output)
    tests = [clip for clip in _clips(args.source, "test", config.frames) if clip.is_moving.all()]
    if tests:
        scores = measure_fingers(model, tests)
        model.save(args.output, read_card(args.output) | {"scores": scores})


def _clips(source: Path, split: str, frames: int) -> Iterator[FingerClip]:
    """Clips of one split of a corpus; of a folder of BVH files, all are for training."""
    if not (source / "manifest.json").is_file():
        yield from _recordings(source, frames) if split == "train" else ()
        return
    corpus = Corpus(source)
    for name in tqdm(corpus.names(split, has_mirrored=False), desc="reading", unit="clip", leave=False, disable=None):
        stored = corpus.motion(name)
        motion = Motion(corpus.skeleton_of(name), stored.rotations, stored.root, float(FRAME_RATE_HZ))
        yield finger_clip(motion, at_least=frames)


def _recordings(folder: Path, frames: int) -> Iterator[FingerClip]:
    """Every BVH below a folder whose rig is known; the log names the others."""
    paths = sorted(folder.rglob("*.bvh"))
    if not paths:
        raise EchoAvatarError(f"{folder} holds neither a corpus nor .bvh files; give another folder")
    left_out = []
    for path in tqdm(paths, desc="reading", unit="clip", leave=False, disable=None):
        motion = read_bvh(path)
        try:
            yield finger_clip(motion, at_least=frames)
        except MotionError:
            left_out.append(path.name)
    if left_out:
        _log.warning("left out, because their rigs are unknown: %s", ", ".join(left_out))


def _train_fid_encoder(given: Given) -> None:
    """Train on the corpus's training clips, then measure how much variance of its test clips the latents preserve."""
    args, settings, corpus = given.args, given.settings, Corpus(given.args.source)
    config = settings.checked(MotionEncoderConfig, "model")
    training = settings.checked(MotionEncoderTraining, "training")
    clips = _features(corpus, "train")
    if not clips:
        raise EchoAvatarError(f"{args.source} has no training clips; make a longer corpus")
    train(MotionEncoderTask(config, training, clips, card=given.card), args.output, **given.how)
    model = MotionEncoder.load(args.output)
    scores = {"explained_train": round(explained_variance(model, clips[:32]), 4)}
    if tests := _features(corpus, "test"):
        scores["explained_test"] = round(explained_variance(model, tests), 4)
    model.save(args.output, read_card(args.output) | {"scores": scores})


def _features(corpus: Corpus, split: str) -> list[Tensor]:
    names = tqdm(corpus.names(split), desc="reading", unit="clip", leave=False, disable=None)
    motions = (corpus.motion(name) for name in names)
    return [motion_features(torch.from_numpy(m.rotations), torch.from_numpy(m.root)) for m in motions]


FINGERS = """SOURCE: a corpus (`echoavatar data rehearse`) or a folder of BVH; frozen fingers are ignored.
examples:
  echoavatar train fingers corpus -o runs/fingers                            about six minutes on a quiet core
  echoavatar train fingers corpus --recordings takes -o runs/fingers         30 % of the windows from recorded takes
  echoavatar train fingers corpus -o runs/fingers --minutes 5                stop after five; call again to continue
then: echoavatar refine-fingers in.bvh out.bvh --model runs/fingers
"""
FID_ENCODER = """examples:
  echoavatar train fid-encoder corpus -o runs/fid                 some minutes on one core
  echoavatar train fid-encoder corpus -o runs/fid --minutes 1     stop after one; call again to resume
then: echoavatar score made true --extractor runs/fid
"""


def stages() -> dict[str, Stage]:
    """The stages by name."""
    corpus = "corpus folder (`data rehearse`, `data prepare`)"
    return {
        "face": Stage(
            "the face model, on pairs of audio and ARKit curves",
            "folder of face clips (`data face`)",
            FaceConfig,
            FaceTraining,
            {"model": shipped("face")},
            (
                *("--steps training.steps", "--batch training.batch", "--rate training.learning_rate"),
                *("--listen training.listen", "--no-tempo training.tempo", "--seed training.seed"),
            ),
            _train_face,
            _add_face,
        ),
        "fingers": Stage(
            "the model behind `refine-fingers`, on motion with good fingers",
            "corpus folder (`data rehearse`), or folder of BVH clips",
            FingerConfig,
            FingerTraining,
            {},
            (
                *("--steps training.steps", "--batch training.batch", "--rate training.learning_rate"),
                *("--width model.width", "--layers model.layers"),
            ),
            _train_fingers,
            _add_fingers,
            FINGERS,
        ),
        "fid-encoder": Stage(
            "the extractor behind `score`'s FID, on the corpus's motion",
            corpus,
            MotionEncoderConfig,
            MotionEncoderTraining,
            {},
            ("--steps training.steps", "--width model.width", "--latent model.latent"),
            _train_fid_encoder,
            examples=FID_ENCODER,
        ),
    }
