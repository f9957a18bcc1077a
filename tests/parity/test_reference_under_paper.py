"""The release's golden clip through a whole pipeline under `--runtime paper`, twice: the release's numbers both times.

The decoder's output is replaced by the golden features, so that all that follows it is tested: nothing of ours touches
them, and the hands are kept off the body as published.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
from tests.golden import golden

from echoavatar.engine import Engine
from echoavatar.engine.pipeline import Pipeline, load_bundle
from echoavatar.engine.pipeline.runtime import Runtime
from echoavatar.models.tokenizer_config import MotionTokenizerConfig
from echoavatar.motion.formats import read_bvh
from echoavatar.motion.kinematics import Skeleton, to_features
from echoavatar.motion.kinematics.rotations import matrix_from_quaternion
from echoavatar.timing import CHUNK_SAMPLES
from echoavatar_lab.models.tokenizer.model import BodyTokenizer
from echoavatar_lab.models.tokenizer.train import body_config
from echoavatar_lab.reference.release_rig import AXES, rig_config, skeleton_config

CHUNKS = 3  # 24 frames
C = np.array(AXES)


def run(tiny_bundle: Path, how: str) -> np.ndarray:
    """Rotations (24, 88, 3, 3) in the release's axes that a session shows."""
    stored = dict(np.load(golden("reference_release/ik.npz")))
    theirs = read_bvh(golden("reference_release/sample_60fps.bvh"), metres_per_unit=1.0).skeleton
    own = Skeleton(skeleton_config(theirs.names, theirs.parents, theirs.offsets, origin="bvh"))
    features = to_features(own, stored["R_in"], stored["trans_in"], up=2)[None]
    plain = load_bundle(tiny_bundle)
    template = MotionTokenizerConfig(features=1, width=16, heads=2, layers=2, codes=8)
    tokenizer = BodyTokenizer(body_config(own, template)).eval()
    rig = rig_config(own.config, np.stack([np.eye(3)] * 88), np.stack([np.eye(3)] * 88))
    bundle = replace(plain.having(tokenizer=tokenizer), runtime=Runtime(rig=rig)).running(how)
    pipeline = Pipeline(bundle, output="native")
    chunks = iter(np.split(np.ascontiguousarray(features, np.float32), range(8, features.shape[1], 8), 1))
    pipeline.decoder.step = lambda *_: next(chunks)
    with Engine(pipeline, seats=1, rewind=0, workers=0).open(seed=1) as session:
        session.push(np.full(CHUNKS * CHUNK_SAMPLES, 0.1, np.float32))
        session.finish()
        shown = np.concatenate([chunk.rotations for chunk in session])
    made: np.ndarray = C.T @ matrix_from_quaternion(shown) @ C
    return made


def test_two_runs_give_the_releases_numbers(tiny_bundle: Path) -> None:
    stored = np.load(golden("reference_release/ik.npz"))
    one, other = run(tiny_bundle, "paper"), run(tiny_bundle, "paper")
    assert np.array_equal(one, other)
    np.testing.assert_allclose(one, stored["R_out"], atol=5e-5, rtol=0)


def test_ours_changes_them(tiny_bundle: Path) -> None:
    """So that the test above can fail."""
    stored = np.load(golden("reference_release/ik.npz"))["R_out"]
    assert np.abs(run(tiny_bundle, "smoother,ground") - stored).max() > 1e-3
