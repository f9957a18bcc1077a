"""Motion and rigs as files: BVH, SMPL, tables (CSV, NPZ), and the rig of a character in a GLB or VRM.

May import `motion.kinematics`, `motion.arkit` and below.
"""

from .bvh import read_bvh
from .bvh_writer import write_bvh
from .tables import read_npz, write_csv, write_npz

__all__ = ["read_bvh", "read_npz", "write_bvh", "write_csv", "write_npz"]
