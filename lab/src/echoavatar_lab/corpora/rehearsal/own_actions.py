"""The actions of every new bundle: the scripts of `action_clips`, made into actions of its tokenizer."""

from dataclasses import replace

import numpy as np

from echoavatar.engine.pipeline.action_making import action_from_motion
from echoavatar.engine.pipeline.actions import Action, ActionLibrary
from echoavatar.models.tokens import UPPER
from echoavatar.motion.action_overlay import Hands, Overlay
from echoavatar.motion.kinematics import Motion
from echoavatar.motion.kinematics.named_bones import finger_bones
from echoavatar.timing import CHUNK_FRAMES
from echoavatar_lab.models.tokenizer.model import BodyTokenizer

from ..controls import minimum_jerk
from .action_clips import SCRIPTS, clip

ARM = ("Shoulder", "UpperArm", "LowerArm", "Hand")
HANDS_EDGE = 14  # frames in which the clip's hands come and go
MOVED = 0.3  # radians from rest: an arm that the clip moves


def own_actions(tokenizer: BodyTokenizer) -> ActionLibrary:
    """The library that ships: every script of `action_clips`; empty where the body is one part."""
    library = ActionLibrary()
    if len(tokenizer.config.parts) <= UPPER:
        return library
    clips = tokenizer.clips()
    for name, script in SCRIPTS.items():
        guides, moving = not script.is_on_top, clip(script)
        action = action_from_motion(clips, name, moving, hold_s=script.hold, about=script.about, guides=guides)
        if script.has_hands:
            action = replace(action, overlay=_with_hands(action, moving))
        library = library.with_action(action)
    return library


def _with_hands(action: Action, moving: Motion) -> Overlay:
    """The action's overlay with the arms that the clip moves, and with their fingers as they differ most from rest."""
    frames = action.chunks * CHUNK_FRAMES
    at = np.minimum(np.arange(frames), moving.frames - 1)
    rotations = moving.rotations[at].astype(np.float32)
    from_rest = np.abs((moving.rotations * moving.rotations[:1]).sum(-1)).clip(0, 1)
    turned = 2 * np.arccos(from_rest)
    names: list[str] = []
    for side in ("left", "right"):
        arm = [side + bone for bone in ARM]
        if turned[:, moving.skeleton.indices(arm)].max() > MOVED:
            fingers = [bone for bones in finger_bones(side).values() for bone in bones]
            most = int(turned[:, moving.skeleton.indices(fingers)].sum(1).argmax())
            rotations[:, moving.skeleton.indices(fingers)] = rotations[most, moving.skeleton.indices(fingers)]
            names += arm + fingers
    rise = minimum_jerk(np.clip((np.arange(frames) + 1) / HANDS_EDGE, 0, 1))
    fall = minimum_jerk(np.clip((moving.frames - 1 - np.arange(frames)) / HANDS_EDGE, 0, 1))
    shares = np.repeat((rise * fall).astype(np.float32)[:, None], len(names), axis=1)
    hands = Hands(tuple(names), rotations[:, moving.skeleton.indices(names)], shares)
    if action.overlay is None:
        return Overlay((), np.zeros((frames, 0, 3), np.float32), hands)
    keep = [i for i, name in enumerate(action.overlay.joints) if name not in names]
    turns = action.overlay.rotation_vectors[:, keep]
    return Overlay(tuple(action.overlay.joints[i] for i in keep), turns, hands)
