"""How far two motions are apart: the same sound and seed through two builds, or two settings.

    echoavatar animate talk.wav -o a.npz --seed 3        # one build
    echoavatar animate talk.wav -o b.npz --seed 3        # the other
    python scripts/compare_motion.py a.npz b.npz

Prints the greatest difference of a joint's rotation (degrees), of the root (millimetres) and of a face curve.
"""

import sys
from pathlib import Path

import numpy as np


def differences(first: Path, second: Path) -> dict[str, float]:
    """Greatest differences of two `.npz` files of the same length."""
    with np.load(first, allow_pickle=False) as a, np.load(second, allow_pickle=False) as b:
        if a["rotations"].shape != b["rotations"].shape:
            raise SystemExit(f"{first} has {len(a['rotations'])} frames, {second} has {len(b['rotations'])}")
        p, q = a["rotations"].astype(np.float64), b["rotations"].astype(np.float64)
        chord = np.minimum(np.linalg.norm(p - q, axis=-1), np.linalg.norm(p + q, axis=-1))  # q and -q are one rotation
        angle = np.degrees(4 * np.arcsin(np.minimum(chord / 2, 1)))
        found = {"joint_deg": angle.max(), "root_mm": 1e3 * np.abs(a["root"] - b["root"]).max()}
        if "face" in a and "face" in b:
            found["face"] = np.abs(a["face"] - b["face"]).max()
    return {name: float(value) for name, value in found.items()}


if __name__ == "__main__":
    for name, value in differences(Path(sys.argv[1]), Path(sys.argv[2])).items():
        print(f"{name:<10} {value:.2g}")
