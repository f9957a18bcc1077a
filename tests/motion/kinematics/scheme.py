"""One way to name the joints of a body.

A scheme is written as lines of joints. `bone=joint` is a joint that is a bone of ours, `=joint` one that is none. The
trunk goes from the root to the head, an arm and a leg outward. `{s}` stands for the side.
"""

from typing import NamedTuple


class Scheme(NamedTuple):
    """One way to name joints."""

    trunk: str
    arm: str
    leg: str
    sides: tuple[str, str]
    fingers: str = ""  # of a joint of a finger: {s}, {digit}, {n} from 0, {k} from 1, {j} nothing, 1, 2
    digits: str = "Thumb Index Middle Ring Pinky"
    arms_at: str = ""  # joint of the trunk that the arms hang from, where it is not the last spine bone
    legs_at: str = ""  # the same of the legs, where it is not the hips
    palm: str = ""  # a joint between the hand and each finger
    has_all_names: bool = True  # whether no bone is told by its place alone
