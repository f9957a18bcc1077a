"""Films: the past as it was, then what the policy goes on with; with the sound of the codes."""

import av
import numpy as np
from tests.align.tuning import clips

from echoavatar.align.policy import GeneratorPolicy
from echoavatar.align.prompts import PromptBook
from echoavatar.align.samples import Films, can_film
from echoavatar.pipeline import load_bundle


def test_films_of_prompts(tiny_bundle, tmp_path):
    assert can_film()
    bundle = load_bundle(tiny_bundle)
    prompts = PromptBook(clips(2, chunks=8), past=1, length=1).spread(2)
    films = Films(bundle.codec, bundle.tokenizer, prompts)
    films(GeneratorPolicy(bundle.generator), tmp_path / "samples" / "step_000001")
    files = sorted(path.name for path in (tmp_path / "samples").iterdir())
    assert files == ["step_000001_0.mp4", "step_000001_1.mp4"]
    with av.open(str(tmp_path / "samples" / files[0])) as film:
        pictures = [frame.to_ndarray(format="rgb24") for frame in film.decode(video=0)]
        assert len(pictures) == 16
        assert np.ptp(pictures[0]) > 50  # a body before a ground
        assert film.streams.audio
