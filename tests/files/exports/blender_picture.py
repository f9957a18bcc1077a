"""Run inside Blender: imports a GLB, BVH or FBX, tells bones and shapes, and draws frames beside each other.

blender --background --python blender_picture.py -- FILE OUT.json [OUT.png FRAME...]
"""

import builtins
import json
import math
import sys

import bpy
import numpy
from mathutils import Vector

if not hasattr(numpy, "bool"):  # Blender 3 asks for it, NumPy 1.24 (Debian 12) has dropped it
    numpy.bool = bool
plain_open = builtins.open  # its BVH reader asks for the mode "rU", which Python 3.11 has dropped
builtins.open = lambda name, mode="r", *more, **others: plain_open(name, mode.replace("U", ""), *more, **others)

words = sys.argv[sys.argv.index("--") + 1 :]
source, told, pictures, frames = words[0], words[1], words[2:3], [int(word) for word in words[3:]]
bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene
scene.render.fps = 30
kind = source.rsplit(".", 1)[1]
if kind == "bvh":
    bpy.ops.import_anim.bvh(filepath=source, global_scale=0.01, use_fps_scale=False, update_scene_duration=True)
elif kind == "fbx":
    bpy.ops.import_scene.fbx(filepath=source)
else:
    bpy.ops.import_scene.gltf(filepath=source)
rig = next(thing for thing in bpy.data.objects if thing.type == "ARMATURE")


def places():
    """World place of each bone's head, in glTF's axes."""
    heads = {bone.name: rig.matrix_world @ bone.head for bone in rig.pose.bones}
    return {name: [head.x, head.z, -head.y] for name, head in heads.items()}


def ahead():
    """1 where it faces the camera's usual side, -1 where it faces away, as VRM 0.x does."""
    x = {name.lower().replace("upper", ""): place[0] for name, place in places().items()}
    left, right = (next(x[name] for name in x if name.endswith(f"{side}arm")) for side in ("left", "right"))
    return 1.0 if left > right else -1.0


action = rig.animation_data.action
last = int(action.frame_range[1])
sampled = sorted({*range(int(action.frame_range[0]), last + 1, 10), *frames})
shaped = [thing.data.shape_keys for thing in bpy.data.objects if thing.type == "MESH" and thing.data.shape_keys]
out = {"first": int(action.frame_range[0]), "last": last, "frames": {}, "shapes": {}, "keys": []}
for frame in sampled:
    scene.frame_set(frame)
    bpy.context.view_layer.update()
    out["frames"][frame] = places()
    out["shapes"][frame] = {block.name: block.value for keys in shaped for block in keys.key_blocks}
out["keys"] = [block.name for keys in shaped for block in keys.key_blocks]
with open(told, "w") as file:
    json.dump(out, file)

if pictures:
    if kind == "bvh":  # a skeleton has nothing to show: a stick from each bone's head to its tail
        for bone in rig.pose.bones:
            length = max(bone.length, 1e-3)
            bpy.ops.mesh.primitive_cylinder_add(radius=min(0.025, 0.2 * length), depth=length)
            stick = bpy.context.object
            stick.parent, stick.parent_type, stick.parent_bone = rig, "BONE", bone.name
            stick.location, stick.rotation_euler = (0, -length / 2, 0), (math.pi / 2, 0, 0)
    bpy.ops.mesh.primitive_plane_add(size=20)
    world = bpy.data.worlds.new("sky")
    world.use_nodes = True
    world.node_tree.nodes["Background"].inputs[0].default_value = (0.6, 0.65, 0.7, 1)
    scene.world = world
    bpy.ops.object.light_add(type="SUN", rotation=(0.7, 0.2, 0.4))
    bpy.context.object.data.energy = 2.5
    bpy.ops.object.camera_add()
    camera = scene.camera = bpy.context.object
    scene.render.engine = "CYCLES"
    scene.cycles.samples, scene.cycles.use_denoising = 8, False
    scene.render.resolution_x, scene.render.resolution_y = 360, 480
    for frame in frames:
        scene.frame_set(frame)
        bpy.context.view_layer.update()
        heads = [Vector(place) for place in places().values()]
        tall = max(head.y for head in heads) + 0.25
        middle = sum((Vector((h.x, -h.z, 0)) for h in heads), Vector()) / len(heads)
        camera.location = middle + Vector((1.0 * ahead(), -2.6 * ahead(), 1.15)) * tall * 0.75
        aim = middle + Vector((0, 0, tall * 0.52)) - camera.location
        camera.rotation_euler = aim.to_track_quat("-Z", "Y").to_euler()
        scene.render.filepath = pictures[0].replace(".png", f"-{frame}.png")
        bpy.ops.render.render(write_still=True)
