import argparse
import shutil
from pathlib import Path

import pytest

from echoavatar.engine.pipeline.foreign_rig import RigConfig
from echoavatar.engine.pipeline.runtime import Runtime
from echoavatar.errors import EchoAvatarError
from echoavatar_lab.commands.actions_build import run
from echoavatar_lab.reference.release_rig import AXES


def test_a_bundle_with_another_rig_is_refused(tmp_path: Path, tiny_bundle: Path) -> None:
    folder = shutil.copytree(tiny_bundle, tmp_path / "bundle")
    Runtime(rig=RigConfig(axes=AXES, metres_per_unit=0.01, up=2)).save(folder)
    with pytest.raises(EchoAvatarError, match="has another rig"):
        run(argparse.Namespace(model=str(folder)))
