"""Write FBX through the user's own Blender or its package `bpy`, which converts a GLB in a separate process.

FBX has no open specification, so a program that knows the format writes it. As Blender runs separately, its licence
does not extend to this package.
"""

import os
import shutil
import subprocess
import sys
import tempfile
from importlib.util import find_spec
from pathlib import Path

from echoavatar.errors import DependencyError, MotionError
from echoavatar.whole_file import whole_file

PROGRAM = "BLENDER"  # environment variable with the path of the program, or of a Python that has `bpy`
TIMEOUT_S = 600.0
_SCRIPT = """
import sys, bpy, numpy
if not hasattr(numpy, "bool"):  # Blender 3 asks for it, NumPy 1.24 (Debian 12) has dropped it
    numpy.bool = bool
source, target = sys.argv[sys.argv.index("--") + 1:]
bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.context.scene.render.fps = FPS
bpy.ops.import_scene.gltf(filepath=source)
def curves(action):
    if hasattr(action, "fcurves"):
        return action.fcurves
    strips = [strip for layer in action.layers for strip in layer.strips]  # Blender 5
    return [curve for strip in strips for bag in strip.channelbags for curve in bag.fcurves]
actions = [a for a in bpy.data.actions if any("pose.bones" in c.data_path for c in curves(a))]
if actions:
    bpy.context.scene.frame_start = int(min(a.frame_range[0] for a in actions))
    bpy.context.scene.frame_end = int(max(a.frame_range[1] for a in actions))
bpy.ops.export_scene.fbx(filepath=target, add_leaf_bones=False, bake_anim=True,
    bake_anim_use_all_actions=False, bake_anim_use_nla_strips=False, bake_anim_simplify_factor=0.0)
"""


def find_blender() -> list[str]:
    """The command that runs a script: with $BLENDER, the Blender on the search path, or Python with `bpy`.

    Raises DependencyError: there is no Blender.
    """
    named = os.environ.get(PROGRAM, "")
    if found := shutil.which(named or "blender"):
        is_python = Path(found).name.startswith("python")
        words = ["--background", "--factory-startup", "--python-exit-code", "1", "--python"]
        return [found, *([] if is_python else words)]
    if not named and find_spec("bpy"):
        return [sys.executable]
    raise DependencyError(
        f"FBX needs Blender, and there is no {named or 'blender'!r}: pip install --no-deps bpy, install the program"
        f" (https://www.blender.org, or apt-get install blender), or set ${PROGRAM} to its path or a Python with bpy"
    )


def write_fbx(path: Path, glb: bytes, fps: float) -> None:
    """Write a GLB with one animation as FBX.

    Raises:
        DependencyError: there is no Blender.
        MotionError: Blender failed; the message ends with its last lines.
    """
    program = find_blender()
    with tempfile.TemporaryDirectory() as folder:
        source, target, script = (Path(folder) / name for name in ("in.glb", "out.fbx", "convert.py"))
        source.write_bytes(glb)
        script.write_text(_SCRIPT.replace("FPS", str(round(fps))), encoding="utf-8")
        words = [*program, str(script), "--", str(source), str(target)]
        try:
            done = subprocess.run(words, capture_output=True, text=True, timeout=TIMEOUT_S)
        except (OSError, subprocess.TimeoutExpired) as error:
            raise MotionError(
                f"{program[0]} did not write {path} ({error}); write .glb and convert it by hand"
            ) from error
        if done.returncode or not target.exists():
            last = (done.stderr or done.stdout).strip().splitlines()[-3:]
            raise MotionError(f"{program[0]} did not write {path}: {' / '.join(last)}; try a newer Blender")
        with whole_file(path, error=MotionError) as partial:
            shutil.copyfile(target, partial)
