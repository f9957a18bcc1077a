"""Retarget EchoAvatar's animations in Unreal: IK rigs, an IK retargeter and the retargeted animations, by one command.

Import a GLB of `echoavatar animate talk.wav -o talk.glb` into the project. Then, in Unreal's console (plugins: Python
Editor Script Plugin, IK Rig; Unreal 5.4 or newer):

    py "PATH/echoavatar_retarget.py" --source /Game/Echo/talk --target /Game/MetaHumans/Ada/Body/m_med_nrw_body
        --rig metahuman --animations /Game/Echo/talk_Anim

`--source` and `--target` are skeletal meshes. `--rig` says whose bones the target has: `metahuman` (also Unreal's
Manny and Quinn), `mixamo`, or `vrm` (an avatar with VRM's bone names). Without `--animations` only the assets are made.
"""

import argparse
import sys
from collections.abc import Sequence
from typing import NamedTuple

import unreal

SIDES = (("Left", "left", "Left", "l"), ("Right", "right", "Right", "r"))  # chain, VRM, Mixamo, Unreal
FINGERS = ("Index", "Middle", "Ring", "Little")


class Chain(NamedTuple):
    """A chain of bones, from its first to its last."""

    name: str
    start: str
    end: str


class Rig(NamedTuple):
    """The bones of a family of skeletons."""

    root: str
    chains: tuple[Chain, ...]


def vrm() -> Rig:
    """EchoAvatar's own bones, which are VRM's."""
    chains = [Chain("Spine", "spine", "upperChest"), Chain("Neck", "neck", "neck"), Chain("Head", "head", "head")]
    for side, own, _, _ in SIDES:
        chains += [
            Chain(f"{side}Clavicle", f"{own}Shoulder", f"{own}Shoulder"),
            Chain(f"{side}Arm", f"{own}UpperArm", f"{own}Hand"),
            Chain(f"{side}Leg", f"{own}UpperLeg", f"{own}Foot"),
            Chain(f"{side}Toe", f"{own}Toes", f"{own}Toes"),
            Chain(f"{side}Thumb", f"{own}ThumbMetacarpal", f"{own}ThumbDistal"),
        ]
        chains += [Chain(f"{side}{one}", f"{own}{one}Proximal", f"{own}{one}Distal") for one in FINGERS]
    return Rig("hips", tuple(chains))


def metahuman() -> Rig:
    """The bones of MetaHuman, Manny and Quinn."""
    chains = [
        Chain("Spine", "spine_01", "spine_05"),
        Chain("Neck", "neck_01", "neck_02"),
        Chain("Head", "head", "head"),
    ]
    for side, _, _, own in SIDES:
        chains += [
            Chain(f"{side}Clavicle", f"clavicle_{own}", f"clavicle_{own}"),
            Chain(f"{side}Arm", f"upperarm_{own}", f"hand_{own}"),
            Chain(f"{side}Leg", f"thigh_{own}", f"foot_{own}"),
            Chain(f"{side}Toe", f"ball_{own}", f"ball_{own}"),
            Chain(f"{side}Thumb", f"thumb_01_{own}", f"thumb_03_{own}"),
        ]
        names = zip(FINGERS, ("index", "middle", "ring", "pinky"), strict=True)
        chains += [Chain(f"{side}{one}", f"{name}_01_{own}", f"{name}_03_{own}") for one, name in names]
    return Rig("pelvis", tuple(chains))


def mixamo() -> Rig:
    """The bones of Mixamo's characters; Unreal's importer drops the namespace `mixamorig:`."""
    chains = [Chain("Spine", "Spine", "Spine2"), Chain("Neck", "Neck", "Neck"), Chain("Head", "Head", "Head")]
    for side, _, own, _ in SIDES:
        chains += [
            Chain(f"{side}Clavicle", f"{own}Shoulder", f"{own}Shoulder"),
            Chain(f"{side}Arm", f"{own}Arm", f"{own}Hand"),
            Chain(f"{side}Leg", f"{own}UpLeg", f"{own}Foot"),
            Chain(f"{side}Toe", f"{own}ToeBase", f"{own}ToeBase"),
            Chain(f"{side}Thumb", f"{own}HandThumb1", f"{own}HandThumb3"),
        ]
        names = zip(FINGERS, ("Index", "Middle", "Ring", "Pinky"), strict=True)
        chains += [Chain(f"{side}{one}", f"{own}Hand{name}1", f"{own}Hand{name}3") for one, name in names]
    return Rig("Hips", tuple(chains))


RIGS = {"vrm": vrm, "metahuman": metahuman, "mixamo": mixamo}


def main(arguments: Sequence[str]) -> None:
    """Make the assets, and retarget what was named."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--source", required=True, help="EchoAvatar's skeletal mesh")
    parser.add_argument("--target", required=True, help="skeletal mesh of your character")
    parser.add_argument("--rig", choices=tuple(RIGS), default="metahuman", help="bones of your character")
    parser.add_argument("--animations", nargs="*", default=[], help="animation sequences to retarget")
    parser.add_argument("--folder", default="/Game/EchoAvatar/Retarget", help="where the assets are made")
    asked = parser.parse_args(arguments)
    source, target = _mesh(asked.source), _mesh(asked.target)
    rigs = [_make_rig(source, vrm(), asked.folder), _make_rig(target, RIGS[asked.rig](), asked.folder)]
    retargeter = _make_retargeter(*rigs, asked.folder)
    if asked.animations:
        animations = [unreal.EditorAssetLibrary.find_asset_data(path) for path in asked.animations]
        unreal.IKRetargetBatchOperation.duplicate_and_retarget(
            animations, source, target, retargeter, suffix=f"_{target.get_name()}"
        )
    unreal.log(f"EchoAvatar: {len(asked.animations)} animations retargeted; assets in {asked.folder}")


def _mesh(path: str) -> "unreal.SkeletalMesh":
    mesh = unreal.EditorAssetLibrary.load_asset(path)
    if not isinstance(mesh, unreal.SkeletalMesh):
        raise ValueError(f"{path} is not a skeletal mesh; copy the reference of one from the Content Browser")
    return mesh


def _make_rig(mesh: "unreal.SkeletalMesh", rig: Rig, folder: str) -> "unreal.IKRigDefinition":
    """An IK rig with the chains of `rig`; chains that the mesh has no bones for are left out with a warning."""
    asset = _create(f"IK_{mesh.get_name()}", folder, unreal.IKRigDefinition, unreal.IKRigDefinitionFactory())
    controller = unreal.IKRigController.get_controller(asset)
    controller.set_skeletal_mesh(mesh)
    if not controller.set_retarget_root(rig.root):
        raise ValueError(f"{mesh.get_name()} has no bone {rig.root}; choose another --rig: {', '.join(RIGS)}")
    for chain in rig.chains:
        name = controller.add_retarget_chain(chain.name, "None", "None", "None")
        is_whole = [
            controller.set_retarget_chain_start_bone(name, chain.start),
            controller.set_retarget_chain_end_bone(name, chain.end),
        ]
        if not all(is_whole):
            controller.remove_retarget_chain(name)
            unreal.log_warning(f"EchoAvatar: {mesh.get_name()} has no bones for {chain.name}; it stays at rest")
    return asset


def _make_retargeter(
    source: "unreal.IKRigDefinition", target: "unreal.IKRigDefinition", folder: str
) -> "unreal.IKRetargeter":
    """A retargeter whose chains are mapped by their equal names, and whose target stands in the source's pose."""
    name = f"RTG_{source.get_name()}_{target.get_name()}"
    asset = _create(name, folder, unreal.IKRetargeter, unreal.IKRetargetFactory())
    controller = unreal.IKRetargeterController.get_controller(asset)
    sides = unreal.RetargetSourceOrTarget
    controller.set_ik_rig(sides.SOURCE, source)
    controller.set_ik_rig(sides.TARGET, target)
    if hasattr(controller, "add_default_ops"):  # Unreal 5.6 and newer: a stack of operations, empty in a new asset
        controller.add_default_ops()
        controller.assign_ik_rig_to_all_ops(sides.SOURCE, source)
        controller.assign_ik_rig_to_all_ops(sides.TARGET, target)
    controller.auto_map_chains(unreal.AutoMapChainType.EXACT, True)
    controller.auto_align_all_bones(sides.TARGET)  # our rest pose is a T, MetaHuman's an A
    return asset


def _create(name: str, folder: str, kind: type, factory: "unreal.Factory") -> "unreal.Object":
    path = f"{folder}/{name}"
    if unreal.EditorAssetLibrary.does_asset_exist(path):
        unreal.EditorAssetLibrary.delete_asset(path)
    asset = unreal.AssetToolsHelpers.get_asset_tools().create_asset(name, folder, kind, factory)
    if asset is None:
        raise RuntimeError(f"{path} could not be made; is the plugin IK Rig on, and the folder writable?")
    return asset


if __name__ == "__main__":
    main(sys.argv[1:])
