"""Videos show the past, then the policy's continuation, with the sound of the codes."""

import av
import numpy as np
from lab.tests.align.tuning_fakes import clips

from echoavatar.engine.pipeline import load_bundle
from echoavatar_lab.align.policy import GeneratorPolicy
from echoavatar_lab.align.prompts import PromptSampler
from echoavatar_lab.align.samples import SampleVideos


def test_videos_of_prompts(tiny_bundle, tmp_path):
    bundle = load_bundle(tiny_bundle)
    prompts = PromptSampler(clips(2, chunks=8), past=1, length=1).spread(2)
    videos = SampleVideos(bundle.codec, bundle.tokenizer, prompts)
    videos(GeneratorPolicy(bundle.generator), tmp_path / "samples" / "step_000001")
    files = sorted(path.name for path in (tmp_path / "samples").iterdir())
    assert files == ["step_000001_0.mp4", "step_000001_1.mp4"]
    with av.open(str(tmp_path / "samples" / files[0])) as video:
        pictures = [frame.to_ndarray(format="rgb24") for frame in video.decode(video=0)]
        assert len(pictures) == 16
        assert np.ptp(pictures[0]) > 50  # a body before a ground
        assert video.streams.audio
