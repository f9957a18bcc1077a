"""The script for Unreal, run against a stand-in that has only what Unreal's documentation lists, and checks bones."""

import importlib.util
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest

from echoavatar.motion.kinematics import HUMANOID

SCRIPT = Path(__file__).parents[3] / "integrations/unreal/echoavatar_retarget.py"
SIDES = ("l", "r")
METAHUMAN = (
    ["root", "pelvis", *(f"spine_0{i}" for i in range(1, 6)), "neck_01", "neck_02", "head"]
    + [
        f"{bone}_{s}"
        for s in SIDES
        for bone in ("clavicle", "upperarm", "lowerarm", "hand", "thigh", "calf", "foot", "ball")
    ]
    + [f"{f}_0{i}_{s}" for s in SIDES for f in ("thumb", "index", "middle", "ring", "pinky") for i in (1, 2, 3)]
)
MIXAMO = (
    ["Hips", "Spine", "Spine1", "Spine2", "Neck", "Head"]
    + [
        s + bone
        for s in ("Left", "Right")
        for bone in ("Shoulder", "Arm", "ForeArm", "Hand", "UpLeg", "Leg", "Foot", "ToeBase")
    ]
    + [
        f"{s}Hand{f}{i}"
        for s in ("Left", "Right")
        for f in ("Thumb", "Index", "Middle", "Ring", "Pinky")
        for i in (1, 2, 3)
    ]
)


class Mesh:
    def __init__(self, name: str, bones: Sequence[str]) -> None:
        self.name, self.bones = name, bones

    def get_name(self) -> str:
        return self.name


class RigAsset(Mesh):
    def __init__(self, name: str) -> None:
        super().__init__(name, ())
        self.root, self.chains = "", dict[str, list[str]]()


class RigController:
    def __init__(self, asset: RigAsset) -> None:
        self.asset = asset

    def set_skeletal_mesh(self, mesh: Mesh) -> bool:
        self.asset.bones = mesh.bones
        return True

    def set_retarget_root(self, bone: str) -> bool:
        self.asset.root = bone
        return bone in self.asset.bones

    def add_retarget_chain(self, chain: str, start: str, end: str, goal: str) -> str:
        assert (start, end, goal) == ("None", "None", "None")
        assert chain not in self.asset.chains
        self.asset.chains[chain] = ["", ""]
        return chain

    def set_retarget_chain_start_bone(self, chain: str, bone: str) -> bool:
        self.asset.chains[chain][0] = bone
        return bone in self.asset.bones

    def set_retarget_chain_end_bone(self, chain: str, bone: str) -> bool:
        self.asset.chains[chain][1] = bone
        return bone in self.asset.bones

    def remove_retarget_chain(self, chain: str) -> bool:
        return self.asset.chains.pop(chain, None) is not None


class RetargeterController:
    def __init__(self, asset: SimpleNamespace) -> None:
        self.asset = asset

    def set_ik_rig(self, side: str, rig: RigAsset) -> None:
        self.asset.rigs[side] = rig

    def auto_map_chains(self, how: str, force: bool) -> None:
        assert (how, force) == ("exact", True)
        self.asset.done.append("map")

    def auto_align_all_bones(self, side: str) -> None:
        self.asset.done.append(f"align {side}")


class NewRetargeterController(RetargeterController):
    """Of Unreal 5.6 and newer."""

    def add_default_ops(self) -> None:
        self.asset.done.append("ops")

    def assign_ik_rig_to_all_ops(self, side: str, rig: RigAsset) -> None:
        assert self.asset.rigs[side] is rig
        self.asset.done.append(f"assign {side}")


class Unreal:
    """The project: meshes by path, what was made, what was said."""

    def __init__(self, controller: type[RetargeterController], meshes: dict[str, Mesh]) -> None:
        self.made: dict[str, object] = {}
        self.said: list[str] = []
        self.retargeted: list[tuple[object, ...]] = []
        self.module = module = ModuleType("unreal")
        library = SimpleNamespace(
            load_asset=meshes.get, does_asset_exist=self.made.__contains__, delete_asset=self.made.pop,
            find_asset_data=lambda path: f"data of {path}",
        )  # fmt: skip
        tools = SimpleNamespace(create_asset=self.create)
        batch = SimpleNamespace(duplicate_and_retarget=self.retarget)
        for name, value in {
            "SkeletalMesh": Mesh, "IKRigDefinition": RigAsset, "IKRigDefinitionFactory": object,
            "IKRetargeter": SimpleNamespace, "IKRetargetFactory": object, "EditorAssetLibrary": library,
            "log": self.said.append, "log_warning": self.said.append, "IKRetargetBatchOperation": batch,
            "AssetToolsHelpers": SimpleNamespace(get_asset_tools=lambda: tools),
            "IKRigController": SimpleNamespace(get_controller=RigController),
            "IKRetargeterController": SimpleNamespace(get_controller=controller),
            "RetargetSourceOrTarget": SimpleNamespace(SOURCE="source", TARGET="target"),
            "AutoMapChainType": SimpleNamespace(EXACT="exact"),
        }.items():  # fmt: skip
            setattr(module, name, value)

    def create(self, name: str, folder: str, kind: type, factory: object) -> object:
        made = RigAsset(name) if kind is RigAsset else SimpleNamespace(get_name=lambda: name, rigs={}, done=[])
        self.made[f"{folder}/{name}"] = made
        return made

    def retarget(self, assets: list[object], source: Mesh, target: Mesh, asset: object, *, suffix: str = "") -> None:
        self.retargeted.append((assets, source, target, asset, suffix))


@pytest.fixture(params=[RetargeterController, NewRetargeterController])
def unreal(request: pytest.FixtureRequest) -> Iterator[Unreal]:
    meshes = {"/Game/own": Mesh("own", HUMANOID.names), "/Game/ada": Mesh("ada", METAHUMAN)}
    meshes |= {"/Game/mix": Mesh("mix", MIXAMO), "/Game/old": Mesh("old", [b for b in METAHUMAN if b != "spine_05"])}
    stand_in = Unreal(request.param, meshes)
    sys.modules["unreal"] = stand_in.module
    yield stand_in
    del sys.modules["unreal"]


def load() -> ModuleType:
    spec = importlib.util.spec_from_file_location("echoavatar_retarget", SCRIPT)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize(("rig", "mesh"), [("metahuman", "ada"), ("mixamo", "mix"), ("vrm", "own")])
def test_every_bone_of_ours_reaches_the_character(unreal: Unreal, rig: str, mesh: str) -> None:
    script = load()
    script.main(["--source", "/Game/own", "--target", f"/Game/{mesh}", "--rig", rig, "--animations", "/Game/talk"])
    ours, theirs = script.vrm(), script.RIGS[rig]()
    assert [chain.name for chain in ours.chains] == [chain.name for chain in theirs.chains]
    covered = {ours.root}
    for chain in ours.chains:
        at = HUMANOID.names.index(chain.end)
        while HUMANOID.names[at] != chain.start:
            covered.add(HUMANOID.names[at])
            at = HUMANOID.parents[at]
        covered.add(chain.start)
    assert covered == {name for name in HUMANOID.names if "Eye" not in name and name != "jaw"}
    (assets, source, target, retargeter, suffix), = unreal.retargeted  # fmt: skip
    assert (assets, suffix, target.get_name()) == (["data of /Game/talk"], f"_{mesh}", mesh)  # type: ignore[attr-defined]
    rigs = retargeter.rigs  # type: ignore[attr-defined]
    assert list(rigs["source"].chains) == list(rigs["target"].chains)
    assert (rigs["source"].root, rigs["target"].root) == ("hips", theirs.root)
    assert retargeter.done[-2:] == ["map", "align target"]  # type: ignore[attr-defined]
    assert len(unreal.said) == 1


def test_what_is_missing_is_said(unreal: Unreal) -> None:
    script = load()
    script.main(["--source", "/Game/own", "--target", "/Game/old"])
    script.main(["--source", "/Game/own", "--target", "/Game/old"])  # again: the assets are made anew
    assert sum("no bones for Spine" in line for line in unreal.said) == 2
    with pytest.raises(ValueError, match="no bone Hips; choose another --rig: vrm, metahuman, mixamo"):
        script.main(["--source", "/Game/own", "--target", "/Game/ada", "--rig", "mixamo"])
    with pytest.raises(ValueError, match="/Game/none is not a skeletal mesh"):
        script.main(["--source", "/Game/none", "--target", "/Game/ada"])
