"""Exported steps beside the modules that they are made from: a tiny bundle with a body of one part and a face."""

import shutil
from copy import deepcopy
from pathlib import Path

import numpy as np
import pytest
import torch
from tests.models.face import tiny as face
from tests.tiny_bundle import CARD, write_bundle

from echoavatar.engine.pipeline import Bundle, Pipeline, load_bundle
from echoavatar.engine.pipeline.undo import Rows
from echoavatar.errors import CheckpointError
from echoavatar.nn.exported import ExportedStep, graph_file
from echoavatar_lab.models.export import export_bundle
from echoavatar_lab.models.generator.model import Generator
from echoavatar_lab.models.generator.sequences import compact_layout
from echoavatar_lab.models.tokenizer.model import BodyTokenizer
from echoavatar_lab.models.tokenizer.train import as_one_part, body_config

pytestmark = pytest.mark.slow
ONE = np.ones(1, np.bool_)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = write_bundle(tmp_path_factory.mktemp("exported"))
    parted = BodyTokenizer.load(made / "tokenizer")
    whole = BodyTokenizer(body_config(as_one_part(parted.skeleton), next(iter(parted.config.parts.values()))))
    whole.mean.copy_(parted.mean)
    whole.std.fill_(0.02)
    for name, book in whole.named_buffers():
        if name.endswith("codebook"):
            book.normal_()
    whole.save(made / "tokenizer", CARD)
    generator = Generator.load(made / "generator")
    layout = compact_layout(audio_codes=16, motion_layers=2, motion_codes=8, parts=1)
    Generator(generator.config.model_copy(update={"layout": layout})).save(made / "generator", CARD)
    face.make().float().save(made / "face", CARD, dtype=torch.float16)
    export_bundle(made)
    return made


@pytest.fixture(scope="module")
def bundle(folder: Path) -> Bundle:
    return load_bundle(folder)


def with_graphs(bundle: Bundle) -> set[str]:
    return {name for name, part in bundle.parts.items() if part.graph}


def sounds(voice: np.ndarray, rows: int = 1) -> list[np.ndarray]:
    """Chunks (b, 6400) of one voice, louder and louder from row to row."""
    loudness = 0.4 + 0.3 * np.arange(rows, dtype=np.float32)
    return np.split(loudness[:, None] * voice[:44_800], 7, 1)


def test_codes_features_and_curves_are_those_of_torch(bundle: Bundle, voice: np.ndarray) -> None:
    in_torch = bundle.having(codec=bundle.codec, tokenizer=bundle.tokenizer, face=bundle.face)
    exported, torch_alone = Pipeline(bundle), Pipeline(in_torch)
    states = [pipeline.init_state(1) for pipeline in (exported, torch_alone)]
    for state in states:
        state.seeds[:] = 3
    for chunk in sounds(voice):
        heard, wanted = (
            pipeline.encode_audio(chunk, state, ONE)
            for pipeline, state in zip((exported, torch_alone), states, strict=True)
        )
        assert (heard == wanted).mean() >= 0.999
        codes = np.random.default_rng(0).integers(8, size=(1, 2, 1, 2))
        made, expected = (
            pipeline.decoder.step(codes, state.decoder, ONE)
            for pipeline, state in zip((exported, torch_alone), states, strict=True)
        )
        np.testing.assert_allclose(made, expected, atol=1e-4)
        assert exported.face is not None
        assert torch_alone.face is not None
        curves, right = (
            stream.step(chunk, state.face[0], ONE, state.seeds)
            for stream, state in zip((exported.face, torch_alone.face), states, strict=True)
        )
        np.testing.assert_allclose(curves, right, atol=1e-4)


def test_a_row_is_the_same_alone_and_in_a_batch_where_others_rest(bundle: Bundle, voice: np.ndarray) -> None:
    pipeline = Pipeline(bundle)
    alone, batch = pipeline.init_state(1), pipeline.init_state(3)
    for row in range(3):
        pipeline.reset(batch, np.arange(3) == row, seed=row)
    pipeline.reset(alone, ONE, seed=1)
    for at, (one, many) in enumerate(zip(sounds(voice), sounds(voice, 3), strict=True)):
        active = np.array([at % 2 == 0, True, False])
        many[1] = one[0]
        (wanted,), made = pipeline.step(one, alone, ONE), pipeline.step(many, batch, active)[1]
        np.testing.assert_allclose(made.rotations, wanted.rotations, atol=1e-5)
        np.testing.assert_allclose(made.face, wanted.face, atol=1e-5)


def test_steps_are_undone_and_restored_to_the_bit(bundle: Bundle, voice: np.ndarray) -> None:
    pipeline = Pipeline(bundle)
    rows = Rows(pipeline.init_state(2))
    state, patches, made = rows.of([1]), [], []
    first, *rest = sounds(voice)
    pipeline.step(first, state, ONE)
    kept = deepcopy(state)
    for chunk in rest:
        before = rows.kept(1)
        made += pipeline.step(chunk, state, ONE)
        patches.append(rows.changes(1, before))
    for patch in reversed(patches):
        rows.undo(1, patch)
    for tensor, saved in zip(state.arrays(), kept.arrays(), strict=True):
        assert np.array_equal(tensor, saved)
    for chunk, one in zip(rest, made, strict=True):
        np.testing.assert_array_equal(pipeline.step(chunk, state, ONE)[0].rotations, one.rotations)


def test_other_weights_than_those_of_the_graph_run_in_torch(folder: Path, tmp_path: Path) -> None:
    mine = Path(shutil.copytree(folder, tmp_path / "mine"))
    tokenizer = BodyTokenizer.load(mine / "tokenizer")
    tokenizer.mean.add_(0.5)
    tokenizer.save(mine / "tokenizer", CARD)
    assert with_graphs(load_bundle(folder)) == {"codec", "tokenizer", "face"}
    assert with_graphs(load_bundle(mine)) == {"codec", "face"}


def test_a_damaged_graph_is_named(folder: Path, tmp_path: Path) -> None:
    mine = Path(shutil.copytree(folder, tmp_path / "mine"))
    graph = graph_file(mine / "codec")
    graph.write_bytes(graph.read_bytes()[:1000])
    with pytest.raises(CheckpointError, match=f"{graph.name} cannot be run"):
        Pipeline(load_bundle(mine))


def test_weights_may_be_a_link_into_another_folder(folder: Path, tmp_path: Path) -> None:
    mine = Path(shutil.copytree(folder / "codec", tmp_path / "codec"))
    (tmp_path / "blobs").mkdir()
    weights = (mine / "model.safetensors").rename(tmp_path / "blobs" / "weights")
    (mine / "model.safetensors").symlink_to(weights)
    assert ExportedStep(graph_file(mine)).init_state(2).parts
