"""FBX by the user's own Blender: a GLB goes in, an FBX comes out, in a process of its own.

FBX has no open specification, so it is left to a program that knows it; run apart, its licence does not touch ours.
"""

import os
import shutil
import subprocess
import tempfile
from pathlib import Path

from ..errors import DependencyError, MotionError

PROGRAM = "BLENDER"  # environment variable that names it
PATIENCE_S = 600.0
_SCRIPT = """
import sys, bpy, numpy
if not hasattr(numpy, "bool"):  # Blender 3 asks for it, NumPy 1.24 (Debian 12) has dropped it
    numpy.bool = bool
source, target = sys.argv[sys.argv.index("--") + 1:]
bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.context.scene.render.fps = FPS
bpy.ops.import_scene.gltf(filepath=source)
actions = [a for a in bpy.data.actions if any("pose.bones" in c.data_path for c in a.fcurves)]
if actions:
    bpy.context.scene.frame_start = int(min(a.frame_range[0] for a in actions))
    bpy.context.scene.frame_end = int(max(a.frame_range[1] for a in actions))
bpy.ops.export_scene.fbx(filepath=target, add_leaf_bones=False, bake_anim=True,
    bake_anim_use_all_actions=False, bake_anim_use_nla_strips=False, bake_anim_simplify_factor=0.0)
"""


def find_blender() -> str:
    """Where Blender is: $BLENDER, or on the path.

    Raises:
        DependencyError: nowhere.
    """
    named = os.environ.get(PROGRAM, "")
    found = shutil.which(named or "blender")
    if found is None:
        raise DependencyError(
            f"FBX is written by Blender, and there is no {named or 'blender'!r}: install it"
            f" (https://www.blender.org, or apt-get install blender), or set ${PROGRAM} to where it is"
        )
    return found


def write_fbx(path: Path, glb: bytes, fps: float) -> None:
    """An FBX of a GLB with one animation.

    Raises:
        DependencyError: there is no Blender.
        MotionError: Blender failed; its last words are in the message.
    """
    program = find_blender()
    with tempfile.TemporaryDirectory() as folder:
        source, target, script = (Path(folder) / name for name in ("in.glb", "out.fbx", "convert.py"))
        source.write_bytes(glb)
        script.write_text(_SCRIPT.replace("FPS", str(round(fps))))
        words = [
            program,
            "--background",
            "--factory-startup",
            "--python-exit-code",
            "1",
            "--python",
            str(script),
        ]
        try:
            done = subprocess.run(
                [*words, "--", str(source), str(target)], capture_output=True, text=True, timeout=PATIENCE_S
            )
        except (OSError, subprocess.TimeoutExpired) as error:
            raise MotionError(f"{program} did not write {path} ({error}); try it by hand") from error
        if done.returncode or not target.exists():
            last = (done.stderr or done.stdout).strip().splitlines()[-3:]
            raise MotionError(f"{program} did not write {path}: {' / '.join(last)}; try a newer Blender")
        try:
            shutil.copyfile(target, path)
        except OSError as error:
            raise MotionError(f"cannot write {path} ({error.strerror}); choose another place") from error
