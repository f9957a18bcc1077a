"""Reference clips of the built-in actions: key poses written as `Controls`, then solved to joint rotations.

Those of `captured_actions` have a key at every frame. Every clip begins and ends standing at ease, so that an action
can start and stop at any point of a session. Times are seconds from the start of the clip; `hold` is the stretch that
repeats while an action is held.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from echoavatar.motion.kinematics import HUMANOID, Motion
from echoavatar.timing import FRAME_RATE_HZ

from ..controls import Controls, mirrored, neutral
from ..dance.poses import ARMS, HANDS, ArmPose
from ..keyframes import glide
from ..solver import solve
from .captured_actions import captured_actions

Array = np.ndarray
Triple = tuple[float, float, float]
Keys = tuple[tuple[float, Controls], ...]
Shake = Callable[[Array, Controls], Controls]
NOTHING: Triple = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Script:
    """One action: its timed poses, the motions on top of them (`shakes`), the stretch to repeat, and its meaning."""

    keys: Keys
    hold: tuple[float, float]
    about: str
    shakes: tuple[Shake, ...] = ()
    is_on_top: bool = False  # moves torso and head only; speech keeps the motion codes
    has_hands: bool = False  # arms and fingers are those of the clip: hands that meet, touch, point or are fists

    @property
    def seconds(self) -> float:
        """Length of the clip."""
        return self.keys[-1][0]


def clip(script: Script) -> Motion:
    """The script's motion at 30 fps on our rig."""
    clock = (np.arange(round(script.seconds * FRAME_RATE_HZ) + 1) / FRAME_RATE_HZ).astype(np.float32)
    times = np.array([time for time, _ in script.keys], np.float32)
    poses = np.concatenate([pose.packed() for _, pose in script.keys])
    controls = Controls.unpacked(glide(clock, times, poses))
    for shake in script.shakes:
        controls = shake(clock, controls)
    rotations, root = solve(controls)
    return Motion(HUMANOID, rotations, root, float(FRAME_RATE_HZ))


def pose(
    left: ArmPose | str | None = None,
    right: ArmPose | str | None = None,
    *,
    head: Triple = NOTHING,
    spine: Triple = NOTHING,
) -> Controls:
    """One frame: arms by name or value (None hangs); head and spine are yaw, pitch, roll on top of standing at ease."""
    body = neutral(1)
    body.head[0] += np.array(head, np.float32)
    body.spine[0] += np.array(spine, np.float32)
    for side, arm in enumerate((left, right)):
        if arm is None:
            continue
        shape = ARMS[arm] if isinstance(arm, str) else arm
        body.wrist[0, side], body.palm[0, side] = shape.wrist, shape.palm
        body.elbow_swing[0, side], body.shoulder[0, side] = shape.elbow, shape.shoulder
        body.fingers[0, side] = HANDS[shape.hand]
    return body


def swing(field: str, index: tuple[int, ...], size: float, hz: float, start: float, stop: float) -> Shake:
    """Add a sine to one curve between two times, faded in and out over a quarter of a second."""

    def shake(clock: Array, controls: Controls) -> Controls:
        fade = np.clip(np.minimum(clock - start, stop - clock) / 0.25, 0, 1)
        curve = getattr(controls, field).copy()
        curve[(slice(None), *index)] += size * fade * np.sin(2 * np.pi * hz * (clock - start))
        return replace(controls, **{field: curve})

    return shake


def _there_and_back(there: Controls, *, reach: float = 0.7, stay: float = 1.2, back: float = 0.8) -> Keys:
    rest = pose()
    return ((0.0, rest), (reach, there), (reach + stay, there), (reach + stay + back, rest))


def _flipped(script: Script, about: str) -> Script:
    """The same action with left and right exchanged."""
    return replace(script, keys=tuple((time, mirrored(body)) for time, body in script.keys), about=about)


def _clapping() -> Keys:
    rest, beats = pose(), []
    for beat in range(6):
        beats += [(0.6 + 0.36 * beat, pose(APART, APART)), (0.78 + 0.36 * beat, pose(TOGETHER, TOGETHER))]
    end = beats[-1][0]
    return ((0.0, rest), *beats, (end + 0.2, pose(APART, APART)), (end + 0.9, rest), (end + 1.2, rest))


WAVING = ArmPose((0.228, 0.148, 0.223), (-0.623, -0.161, 0.249), -0.222, (0.256, -0.048), "open")
CHIN = ArmPose((-0.156, -0.029, 0.152), (-0.19, 0.153, -0.222), 0.346, (-0.161, 0.142), "loose_fist")
UNDER = ArmPose((-0.20, -0.26, 0.24), (0.1, 0.0, 0.6), 0.1, (0.0, 0.1), "loose_fist")
TOGETHER = ArmPose((-0.142, -0.206, 0.295), (-0.714, 0.35, 0.139), 0.146, (-0.2, 0.139), "flat")
APART = ArmPose((-0.009, -0.201, 0.286), (-0.475, 0.35, -0.118), -0.019, (-0.2, 0.035), "flat")
PALM_UP = ArmPose((0.24, -0.16, 0.25), (-0.2, 0.0, -1.2), -0.1, (0.55, 0.0), "open")
POINTING = ArmPose((0.477, 0.021, 0.257), (0.13, -0.314, 0.673), -0.059, (0.173, -0.1), "point")
FISTS = ArmPose((0.06, -0.14, 0.28), (0.0, 0.0, 0.2), 0.25, (0.15, 0.05), "fist")
FISTS_DOWN = ArmPose((0.08, -0.26, 0.30), (0.0, 0.0, 0.2), 0.3, (0.1, 0.05), "fist")
SLUMPED = ArmPose((0.07, -0.47, 0.10), (0.15, 0.0, 0.4), 0.0, (-0.12, 0.2))
SHOWN = ArmPose((0.11, -0.04, 0.27), (-0.1, 0.0, 0.9), 0.05, (0.05, 0.0), "point")
AHEAD = ArmPose((0.02, -0.08, 0.45), (0.0, 0.0, 0.9), 0.1, (0.05, 0.15), "point")
GROUND = ArmPose((0.04, -0.27, 0.36), (0.5, 0.0, 1.0), 0.15, (0.0, 0.1), "point")
GIVING = ArmPose((0.05, -0.22, 0.40), (-0.1, 0.0, -1.1), -0.05, (0.0, 0.1), "open")
ASIDE = ArmPose((0.30, -0.14, 0.30), (-0.1, 0.0, -1.0), -0.05, (0.05, 0.0), "open")
NARROW = ArmPose((-0.03, -0.17, 0.32), (0.0, 0.0, 0.0), 0.1, (0.0, 0.05), "flat")
BROAD = ArmPose((0.13, -0.14, 0.34), (0.0, 0.0, 0.0), 0.1, (0.05, 0.0), "open")
WHOLE = ArmPose((0.42, 0.0, 0.20), (-0.2, 0.0, -0.5), 0.0, (0.1, 0.0), "open")
TALL = ArmPose((0.20, 0.20, 0.26), (0.3, 0.0, 1.4), 0.2, (0.2, 0.0), "flat")
SHORT = ArmPose((0.18, -0.38, 0.24), (-0.5, 0.0, 1.4), 0.1, (-0.05, 0.0), "flat")
GOOD = ArmPose((0.05, -0.13, 0.34), (0.0, 0.0, 0.0), 0.1, (0.0, 0.05), "thumb_up")
SALUTING = ArmPose((0.06, 0.17, 0.14), (0.1, 0.0, 0.9), 0.5, (0.15, 0.0), "flat")
HALT = ArmPose((0.03, -0.02, 0.42), (-0.9, 0.0, 1.2), 0.1, (0.05, 0.15), "flat")

_RAISE_LEFT = Script(
    _there_and_back(pose("up"), reach=0.8, stay=1.3, back=0.9), (0.9, 2.0), "raise the left hand high", has_hands=True
)
_POINT_LEFT = Script(
    _there_and_back(pose(POINTING, head=(0.45, 0.0, 0.0), spine=(0.15, 0.0, 0.0))),
    (0.8, 1.8),
    "point to the left",
    has_hands=True,
)


def _right(arm: ArmPose, about: str, *shakes: Shake, left: ArmPose | None = None, head: Triple = NOTHING) -> Script:
    """The right arm, or both, go into a pose and back."""
    keys = _there_and_back(pose(left, arm, head=head), reach=0.55, stay=1.0, back=0.7)
    return Script(keys, (0.55, 1.55), about, shakes, has_hands=True)


def _both(arm: ArmPose, about: str, *shakes: Shake, head: Triple = NOTHING) -> Script:
    return _right(arm, about, *shakes, left=arm, head=head)


_ON_RIGHT = _right(ASIDE, "an open hand to the right: on the other hand, there", head=(-0.25, 0.05, 0.0))
_NOD = swing("head", (1,), 0.30, 1.9, 0.2, 2.1)
_SHAKE = swing("head", (0,), 0.42, 1.5, 0.2, 2.3)

_WRITTEN: Mapping[str, Script] = {
    "raise_left_hand": _RAISE_LEFT,
    "raise_right_hand": _flipped(_RAISE_LEFT, "raise the right hand high"),
    "raise_both_hands": Script(
        _there_and_back(pose("vee", "vee", head=(0.0, -0.1, 0.0)), reach=0.8, stay=1.3, back=0.9),
        (0.9, 2.0),
        "raise both hands high",
        has_hands=True,
    ),
    "wave": Script(
        _there_and_back(pose(None, WAVING, head=(-0.1, 0.0, 0.08)), stay=1.9),
        (0.8, 2.5),
        "wave the right hand in greeting or farewell",
        (swing("wrist", (1, 0), 0.10, 2.0, 0.7, 2.6), swing("palm", (1, 1), 0.3, 2.0, 0.7, 2.6)),
        has_hands=True,
    ),
    "look_around": Script(
        (
            (0.0, pose()),
            (0.7, pose(head=(0.85, 0.0, 0.0), spine=(0.25, 0.0, 0.0))),
            (1.3, pose(head=(0.85, 0.05, 0.0), spine=(0.25, 0.0, 0.0))),
            (2.2, pose(head=(-0.85, 0.0, 0.0), spine=(-0.25, 0.0, 0.0))),
            (2.8, pose(head=(-0.85, -0.1, 0.0), spine=(-0.25, 0.0, 0.0))),
            (3.5, pose()),
            (3.8, pose()),
        ),
        (0.6, 2.9),
        "look to the left and to the right, as if searching",
        is_on_top=True,
    ),
    "thinking": Script(
        _there_and_back(pose(UNDER, CHIN, head=(0.15, 0.12, 0.12)), reach=0.9, stay=1.6),
        (1.0, 2.4),
        "hand to the chin, thinking",
        has_hands=True,
    ),
    "agree": Script(((0.0, pose()), (2.4, pose())), (0.3, 2.1), "nod", (_NOD,), is_on_top=True),
    "disagree": Script(((0.0, pose()), (2.6, pose())), (0.3, 2.2), "shake the head", (_SHAKE,), is_on_top=True),
    "give_up": Script(
        _there_and_back(pose(PALM_UP, PALM_UP, head=(0.0, 0.05, 0.16)), reach=0.55, stay=0.8),
        (0.6, 1.3),
        "shrug with open palms: no idea, nothing to be done",
        has_hands=True,
    ),
    "point_left": _POINT_LEFT,
    "point_right": _flipped(_POINT_LEFT, "point to the right"),
    "bow": Script(
        _there_and_back(
            pose(SLUMPED, SLUMPED, head=(0.0, 0.3, 0.0), spine=(0.0, 0.75, 0.0)), reach=0.9, stay=0.7, back=1.0
        ),
        (1.0, 1.5),
        "bow in greeting, thanks or farewell",
    ),
    "clap": Script(_clapping(), (0.6, 2.4), "clap the hands", has_hands=True),
    "angry": Script(
        (
            (0.0, pose()),
            (0.5, pose(FISTS, FISTS, head=(0.0, 0.12, 0.0), spine=(0.0, 0.12, 0.0))),
            (0.8, pose(FISTS_DOWN, FISTS_DOWN, head=(0.0, 0.2, 0.0), spine=(0.0, 0.18, 0.0))),
            (1.2, pose(FISTS, FISTS, head=(0.0, 0.12, 0.0), spine=(0.0, 0.12, 0.0))),
            (1.5, pose(FISTS_DOWN, FISTS_DOWN, head=(0.0, 0.2, 0.0), spine=(0.0, 0.18, 0.0))),
            (1.9, pose(FISTS, FISTS, head=(0.0, 0.12, 0.0), spine=(0.0, 0.12, 0.0))),
            (2.7, pose()),
            (3.0, pose()),
        ),
        (0.5, 1.9),
        "angry: clenched fists that shake",
        has_hands=True,
    ),
    "sad": Script(
        _there_and_back(pose(SLUMPED, SLUMPED, head=(0.0, 0.45, 0.08), spine=(0.0, 0.22, 0.0)), reach=1.0, stay=1.8),
        (1.1, 2.7),
        "sad: head and shoulders sink",
    ),
    "happy": Script(
        (
            (0.0, pose()),
            (0.5, pose("side_high", "side_high", head=(0.0, -0.12, 0.06), spine=(0.0, -0.08, 0.0))),
            (0.85, pose("vee", "vee", head=(0.0, -0.15, -0.06), spine=(0.0, -0.08, 0.0))),
            (1.2, pose("side_high", "side_high", head=(0.0, -0.12, -0.06), spine=(0.0, -0.08, 0.0))),
            (1.55, pose("vee", "vee", head=(0.0, -0.15, 0.06), spine=(0.0, -0.08, 0.0))),
            (1.9, pose("side_high", "side_high", head=(0.0, -0.12, 0.06), spine=(0.0, -0.08, 0.0))),
            (2.7, pose()),
            (3.0, pose()),
        ),
        (0.5, 1.9),
        "happy: arms thrown up with joy",
        has_hands=True,
    ),
    "neutral": Script(((0.0, pose()), (1.6, pose())), (0.0, 1.6), "stand at ease, hands down"),
    "nod": Script(
        ((0.0, pose()), (1.3, pose())),
        (0.2, 1.1),
        "a short nod while listening",
        (swing("head", (1,), 0.17, 1.8, 0.1, 1.2),),
        is_on_top=True,
    ),
    "listen": Script(
        _there_and_back(pose(head=(0.0, 0.0, 0.16)), reach=0.8, stay=1.6),
        (0.8, 2.4),
        "listen: head a little tilted",
        is_on_top=True,  # arms stay where they are: nods come and go while the user speaks
    ),
    "count_one": _right(SHOWN, "raise one finger: one, first, wait a moment"),
    "count_two": _right(replace(SHOWN, hand="two"), "show two fingers: two, second"),
    "count_three": _right(replace(SHOWN, hand="three"), "show three fingers: three, third"),
    "point_up": _right(replace(SHOWN, wrist=(0.16, 0.16, 0.22)), "point up: above, high", head=(-0.1, -0.25, 0.0)),
    "point_down": _right(GROUND, "point down: below, here on the ground", head=(-0.1, 0.25, 0.0)),
    "point_forward": _right(AHEAD, "point ahead with a finger: you, over there"),
    "you": _right(GIVING, "hold an open hand out to the listener: you, your turn"),
    "on_one_side": _flipped(_ON_RIGHT, "an open hand to the left: on the one hand, there"),
    "on_other_side": _ON_RIGHT,
    "explain": _both(
        GIVING, "hold out both open hands: look, that is how it is", swing("wrist", (0, 1), 0.03, 1.3, 0.5, 1.6)
    ),
    "small": _both(NARROW, "hands close together: small, little, a bit", head=(0.0, 0.12, 0.0)),
    "big": _both(BROAD, "hands far apart: big, much"),
    "everything": _both(WHOLE, "spread both arms wide: everything, all of us, the whole world", head=(0.0, -0.08, 0.0)),
    "tall": _right(TALL, "a flat hand held high: tall, more, it rises", head=(-0.15, -0.15, 0.0)),
    "short": _right(SHORT, "a flat hand held low: short, less, it falls", head=(-0.1, 0.15, 0.0)),
    "thumbs_up": _right(GOOD, "thumb up: well done, fine, agreed", head=(0.0, 0.06, 0.06)),
    "stop": _right(HALT, "a flat hand against the listener: stop, wait"),
    "refuse": _both(
        HALT,
        "wave both hands before the body: no, out of the question",
        swing("wrist", (0, 0), 0.07, 1.6, 0.4, 1.7),
        swing("wrist", (1, 0), 0.07, 1.6, 0.4, 1.7),
        swing("head", (0,), 0.2, 1.6, 0.4, 1.7),
    ),
    "salute": _right(SALUTING, "salute: at your service"),
    "please": _both(TOGETHER, "palms together: please, I beg you", head=(0.0, 0.2, 0.0)),
    "hands_on_hips": Script(
        _there_and_back(pose("hip", "hip")), (0.7, 1.9), "both hands on the hips: ready, resolute", has_hands=True
    ),
    "look_up": Script(
        _there_and_back(pose(head=(0.1, -0.4, 0.0))), (0.7, 1.9), "look up, as to the sky", is_on_top=True
    ),
    "look_down": Script(_there_and_back(pose(head=(0.0, 0.5, 0.0))), (0.7, 1.9), "look down", is_on_top=True),
}
_CAPTURED = {
    name: Script(
        tuple((at / FRAME_RATE_HZ, one.controls[at : at + 1]) for at in range(len(one.controls))),
        one.hold,
        one.about,
        has_hands=True,
    )
    for name, one in captured_actions().items()
}
SCRIPTS: Mapping[str, Script] = {**_WRITTEN, **_CAPTURED}
