import json
import shutil
from pathlib import Path

import pytest

from echoavatar.errors import CheckpointError
from echoavatar.pipeline import load_bundle


def test_a_bundle_loads_with_its_parts_fitting(tiny_bundle: Path) -> None:
    bundle = load_bundle(tiny_bundle)
    assert bundle.skeleton.joints == 52
    assert bundle.generator.config.layout.motion_layers == bundle.tokenizer.config.layers == 2
    assert bundle.parameters > 1000


def test_an_unknown_name_lists_what_there_is() -> None:
    with pytest.raises(CheckpointError, match="no bundle 'nonsense'"):
        load_bundle("nonsense")


def test_a_missing_part_is_named(tiny_bundle: Path, tmp_path: Path) -> None:
    shutil.copytree(tiny_bundle, tmp_path / "b")
    shutil.rmtree(tmp_path / "b" / "codec")
    with pytest.raises(CheckpointError, match="codec missing"):
        load_bundle(tmp_path / "b")


def test_parts_that_do_not_speak_the_same_codes_are_refused(tiny_bundle: Path, tmp_path: Path) -> None:
    folder = tmp_path / "b"
    shutil.copytree(tiny_bundle, folder)
    config = json.loads((folder / "generator" / "config.json").read_text())
    from echoavatar.generator import Generator, GeneratorConfig
    from echoavatar.tokens import TokenLayout

    layout = TokenLayout.compact(audio_codes=32, motion_layers=2, motion_codes=8)
    Generator(GeneratorConfig(**(config | {"layout": layout}))).save(folder / "generator", {})
    with pytest.raises(CheckpointError, match="32 audio codes, the other part 16"):
        load_bundle(folder)
