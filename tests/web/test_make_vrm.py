import json
import struct

from tests.web.make_vrm import make_vrm


def test_the_file_is_whole_and_names_what_a_vrm_must_have():
    data = make_vrm()
    magic, version, total, length, kind = struct.unpack_from("<4sIII4s", data)
    assert (magic, version, total, kind) == (b"glTF", 2, len(data), b"JSON")
    document = json.loads(data[20 : 20 + length])
    vrm = document["extensions"]["VRMC_vrm"]
    assert {"hips", "spine", "head", "leftHand", "rightFoot"} <= set(vrm["humanoid"]["humanBones"])
    assert set(vrm["expressions"]["preset"]) == {"aa", "ih", "ou", "ee", "oh", "blink"}
    assert all(node.get("mesh", 0) < len(document["meshes"]) for node in document["nodes"])
