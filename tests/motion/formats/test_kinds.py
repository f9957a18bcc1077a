"""A file of motion or of a character is known by its content."""

import os
from pathlib import Path

import numpy as np
import pytest
from tests.files.exports.bodies import offsets_of
from tests.files.exports.odd import Odd, glb
from tests.motion.kinematics.samples import swaying

from echoavatar.errors import MotionError
from echoavatar.files.exports import read_rig, read_take
from echoavatar.motion.formats import write_bvh
from echoavatar.motion.formats.joint_map import map_of
from echoavatar.motion.formats.kinds import BVH, GLTF, NPZ, kind_of

HEADS = [
    (b"HIERARCHY\nROOT a", BVH),
    (b"\xef\xbb\xbf \r\nhierarchy\n", BVH),
    (b"# made by hand\n// twice\nHIERARCHY", BVH),
    ("HIERARCHY\n".encode("utf-16"), BVH),
    ("HIERARCHY\n".encode("utf-16-be"), BVH),
    (b"glTF\2\0\0\0", GLTF),
    (b'\n {"asset": {}}', GLTF),
    (b"PK\3\4", NPZ),
]


@pytest.mark.parametrize(("head", "kind"), HEADS)
@pytest.mark.parametrize("name", ["a", "a.txt", "a.fbx", "a.bvh", "a.glb", "a.npz"])
def test_the_content_counts_and_not_the_name(head: bytes, kind: str, name: str, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(head)
    assert kind_of(tmp_path / name) == kind


def test_without_a_sign_in_the_content_the_name_counts(tmp_path: Path) -> None:
    (tmp_path / "A.BVH").write_bytes(b"")
    assert kind_of(tmp_path / "A.BVH") == BVH


@pytest.mark.parametrize("content", [b"Kaydara FBX Binary  \0", b"\x93NUMPY\1\0", b"\x80\4\x95", b"Timestamp,Hips"])
def test_other_files_are_named_with_the_remedy(content: bytes, tmp_path: Path) -> None:
    (tmp_path / "a.fbx").write_bytes(content)
    assert not kind_of(tmp_path / "a.fbx")
    with pytest.raises(MotionError, match=r"a\.fbx is neither .npz nor .bvh nor .glb; convert it, .*in Blender"):
        read_take(tmp_path / "a.fbx")
    with pytest.raises(MotionError, match=r"a\.fbx is not a rig: convert it to a .*\.glb.*\.bvh"):
        read_rig(tmp_path / "a.fbx")
    with pytest.raises(MotionError, match=r"a\.fbx is not binary glTF"):
        map_of(tmp_path / "a.fbx")


def test_what_is_missing_or_no_file_is_left_to_its_reader(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.bvh")
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "loop").symlink_to("loop")
    for name, said in (
        ("none.bvh", "not exist"), ("pipe.bvh", "not a regular file"),
        ("*.fbx", "not exist"), ("pipe", "not a regular file"), ("loop", "cannot be read"), ("", "not a regular file"),
    ):  # fmt: skip
        for read in (read_take, read_rig):
            with pytest.raises(MotionError, match=said):
                read(tmp_path / name)
    assert kind_of(tmp_path / ("x" * 300 + ".glb")) == GLTF


def test_every_reader_of_bodies_goes_by_it(tmp_path: Path) -> None:
    person = swaying(2)
    write_bvh(tmp_path / "a.txt", person.skeleton, person.rotations, person.root, 30)
    (tmp_path / "b.txt").write_bytes(glb(Odd(offsets_of(body=0.9, legs=1.1, arms=1.2))))
    assert read_take(tmp_path / "a.txt").motion.frames == 2
    for name in ("a.txt", "b.txt"):
        assert map_of(tmp_path / name)["leftHand"]
        assert np.isfinite(read_rig(tmp_path / name).skeleton.rest_positions).all()
