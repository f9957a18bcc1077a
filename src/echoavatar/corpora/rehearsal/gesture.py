"""Speech to gesture: preparation, stroke, hold and retraction, one gesture unit per phrase (Kendon, McNeill).

A generator predicts this motion from the audio heard so far, so a stroke must not announce itself before it can be
heard: the hand waits, the stroke begins with the stressed vowel and ends 0.14 to 0.18 s after its centre, and the hand
returns at once to where it waits for the next stroke. An earlier preparation would teach the generator to gesture
without listening. Hands rise with the phrase and sink after it. Beats fall on prominent syllables, words with a
meaning get a gesture of their own, and head, torso and clavicles follow.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from .controls import Array, Controls, critically_damped, wander
from .gesture_cues import Cue, gesture_cues
from .handpath import FINGERS, PALM, WRIST, HandPath
from .handshapes import count_shape, hand_shape
from .head_motion import head_accents, speech_activity
from .idle import Manner, draw_manner, finger_drift, hands_of, idle, resting_hands, with_hands
from .lexicon import ACCENTS, MEANINGS, Form, aim_at, eased_reach, home_of, meant_form
from .sound import SoundTrack

SINK_AFTER, REST_AFTER = 0.10, 0.30  # seconds after a phrase: the hands relax, then drop
SHORTEST_SINK_GAP, SHORTEST_REST_GAP = (
    0.50,
    1.35,
)  # seconds: in shorter pauses the hands wait, in longer ones they sink or go to rest
LOW = np.array([-0.045, -0.385, 0.190], np.float32)  # wrist of a raised hand that does not lead
RISING, SINKING = np.array([0.03, 0.0, 0.05], np.float32), np.array([0.03, 0.0, 0.02], np.float32)
LAUNCH_S = -0.04  # from the vowel's centre to the start of a stroke, which is about the start of the vowel
BACK_S = 0.30  # duration of a beat's return, right after its stroke
LEFT, RIGHT = 0, 1


def gesture(track: SoundTrack, seed: int) -> Controls:
    """Idle motion for the whole track with gesture units over every phrase."""
    manner, rng = draw_manner(seed), np.random.default_rng([seed, 3])
    body = idle(track, seed)
    frames = len(body)
    rest = resting_hands(manner.rest)
    speaker = _Speaker(manner, rng, [HandPath(rest[LEFT].copy()), HandPath(rest[RIGHT].copy())], rest)
    starts = [begin for begin, _ in track.phrases] + [np.inf]
    for phrase, following in zip(track.phrases, starts[1:], strict=True):
        speaker.say(phrase, gesture_cues(track, phrase, manner, rng), following)
    moved = np.stack([path.curve(frames) for path in speaker.hands], axis=1) - rest
    active = speech_activity(track, frames)
    lively = np.clip(np.abs(moved[..., :3]).sum(-1) / 0.2, 0, 1)[..., None]
    moved[..., FINGERS] += finger_drift(frames, rng) * (0.4 + 0.8 * lively)
    moved[..., :3] += wander(frames, 6, period=1.2, rng=rng).reshape(frames, 2, 3) * 0.004 * lively
    head, spine = head_accents(track, manner.nod, rng)
    body = replace(body, head=body.head + head, spine=body.spine + spine)
    return with_following_torso(with_hands(body, hands_of(body) + moved), hands_of(body), active)


class _Speaker:
    """Plans the paths of both hands phrase by phrase, and remembers which hand leads and where its home is."""

    def __init__(self, manner: Manner, rng: np.random.Generator, hands: list[HandPath], rest: Array) -> None:
        self.manner, self.rng, self.hands, self.rest = manner, rng, hands, rest
        self.lead = RIGHT if rng.random() < manner.handed else LEFT
        self.second = self._role()
        self.up = [False, False]
        self.homes = [home_of(manner.space, rng), home_of(manner.space, rng)]
        taste = rng.dirichlet(np.full(len(ACCENTS), 1.4))
        self.taste = 0.5 * taste + 0.5 / len(ACCENTS)
        self.beat_way = self._beat_way()
        self.free_at = 0.0

    def say(self, phrase: tuple[float, float], cues: list[Cue], following: float) -> None:
        """Plan one gesture unit: rise, strokes, and retraction if the pause is long enough."""
        begin, end = phrase
        self._choose_hands()
        if cues and self.rng.random() > 0.05:
            self._raise(begin, cues[0])
            for cue in cues:
                if cue.stroke_end > self.free_at:
                    self._do(cue, end)
        gap = following - end
        if gap > SHORTEST_REST_GAP or (gap > SHORTEST_SINK_GAP and self.rng.random() < 0.3):
            self._retract(end)
        elif gap > SHORTEST_SINK_GAP:
            self._sink(end, 0.28)

    def _choose_hands(self) -> None:
        """Sometimes change the leading hand, the role of the second hand or the home position."""
        rng = self.rng
        if rng.random() < 0.35:
            self.lead = RIGHT if rng.random() < self.manner.handed else LEFT
        if rng.random() < 0.40:
            self.second = self._role()
        if rng.random() < 0.5:
            self.homes = [home_of(self.manner.space, rng) for _ in self.hands]
            self.homes[1 - self.lead][3:] = self.homes[self.lead][3:]
            self.beat_way = self._beat_way()
        if 0 < self.second < 0.4:
            self.homes[1 - self.lead][WRIST] = LOW + rng.normal(0, 0.02, 3)

    def _role(self) -> float:
        """The share of the leading hand's movement that the second hand makes: most of it, a little, or none."""
        kind = self.rng.random()
        return float(self.rng.uniform(0.6, 1.0)) if kind < 0.55 else 0.3 if kind < 0.82 else 0.0

    def _beat_way(self) -> Array:
        """The direction of the next beats: mostly down, some outwards or inwards."""
        ways = ((0.15, -1.0, 0.25), (0.6, -0.7, 0.35), (-0.35, -0.8, 0.25), (0.25, -0.45, 0.8))
        way = np.array(ways[self.rng.choice(4, p=(0.45, 0.25, 0.12, 0.18))]) + self.rng.normal(0, 0.12, 3)
        return np.asarray(way / np.linalg.norm(way), np.float32)

    def _raise(self, begin: float, first: Cue) -> None:
        """Raise the hands at the start of a phrase, in an arc away from the body."""
        sides = [self.lead, 1 - self.lead] if self.second else [self.lead]
        for delay, side in zip((0.0, float(self.rng.uniform(0.0, 0.12))), sides, strict=False):
            start = begin + float(self.rng.uniform(0.0, 0.10)) + delay
            length = float(np.clip(first.stroke_end - start - 0.15, 0.50, 0.80))
            arc = RISING if not self.up[side] else None
            self.hands[side].move(start, start + length, self.homes[side], arc)
            self.up[side] = True

    def _do(self, cue: Cue, phrase_end: float) -> None:
        if cue.meaning:
            self._mean(cue, phrase_end)
        elif cue.weight >= 0.80 and self.rng.random() < 0.40:
            self._accent(cue)
        else:
            self._beat(cue)

    def _beat(self, cue: Cue) -> None:
        """Move down with the vowel and up again at once, where the hand waits for the next beat."""
        size = (0.055 + 0.150 * cue.weight**1.5) * self.manner.energy * float(self.rng.uniform(0.75, 1.25))
        for side in self._moving():
            share = size * (1.0 if side == self.lead else self.second * float(self.rng.uniform(0.7, 1.1)))
            home, way = self.homes[side], self.beat_way + self.rng.normal(0, 0.10, 3)
            high, low = home.copy(), home.copy()
            high[WRIST] -= way * share * 0.50
            high[PALM] += (0.35 * share / 0.1 * -0.5, 0.10 * share / 0.1, 0.0)
            low[WRIST] += way * share * 0.50
            low[WRIST] = eased_reach(low[WRIST])
            low[PALM] += self.rng.normal(0, 0.10, 3) + (0.08, -0.10 * share / 0.1, 0.0)
            low[FINGERS] += self.rng.normal(0, 0.05, 7)
            path, end = self.hands[side], cue.stroke_end
            path.move(cue.vowel + LAUNCH_S, end, low)
            path.move(end, end + BACK_S, high)
        self.homes[self.lead][WRIST] += self.rng.normal(0, 0.012, 3)

    def _accent(self, cue: Cue) -> None:
        """A larger gesture for the phrase's nucleus; the hand's home moves there."""
        names = list(ACCENTS)
        form = ACCENTS[names[self.rng.choice(len(names), p=self.taste)]]
        size = self.manner.energy * self.manner.space * float(self.rng.uniform(0.8, 1.25))
        for side in self._moving() if self.second > 0.4 else [self.lead]:
            self._reach(side, cue, form, size * (1.0 if side == self.lead else self.second))

    def _mean(self, cue: Cue, phrase_end: float) -> None:
        """The gesture for a word's meaning, held for a moment."""
        name = meant_form(cue.meaning, cue.word)
        form, size = MEANINGS[name], self.manner.space * float(self.rng.uniform(0.9, 1.15))
        two_handed = name in ("size", "small", "question") or (name == "negation" and self.rng.random() < 0.5)
        if name == "contrast":
            self.lead = 1 - self.lead
        if name == "count":
            form = replace(form, shape=count_shape(cue.word))
        if name == "negation":
            self._inwards(cue, two_handed)
        sides = [LEFT, RIGHT] if two_handed else [self.lead]
        for side in sides:
            self._reach(side, cue, form, size)
        if name == "greeting":
            self._wave(cue, phrase_end)
        self.free_at = cue.stroke_end + (0.35 if name in ("size", "count", "there", "question") else 0.15)

    def _inwards(self, cue: Cue, two_handed: bool) -> None:
        """Move the hand to the middle before it wipes outwards."""
        for side in [LEFT, RIGHT] if two_handed else [self.lead]:
            inner = self.homes[side].copy()
            inner[WRIST] = (-0.05, -0.20 if side == self.lead else -0.24, 0.28)
            inner[5] = 1.0
            self.hands[side].move(cue.onset, max(cue.stroke_end - 0.14, cue.onset + 0.15), inner)

    def _reach(self, side: int, cue: Cue, form: Form, size: float) -> None:
        """A stroke along an arc from the hand's present place; it takes longer than planned if the way is long."""
        path = self.hands[side]
        aim = aim_at(form, self.homes[side], size=size, space=self.manner.space, rng=self.rng)
        way = float(np.linalg.norm(aim[WRIST] - path.aim[WRIST]))
        begin = cue.vowel + LAUNCH_S
        end = max(cue.stroke_end, begin + way / 1.0)
        arc = np.array(form.arc, np.float32) * min(1.0, way / 0.12)
        path.stroke(begin, end, aim, overshoot=float(self.rng.uniform(0.06, 0.14)), arc=arc)
        self.up[side] = True
        self.homes[side] = aim.copy()
        self.homes[side][FINGERS] = 0.5 * aim[FINGERS] + 0.5 * hand_shape("relaxed")

    def _wave(self, cue: Cue, phrase_end: float) -> None:
        """Swing the forearm from side to side with decreasing size."""
        path, time, reach = self.hands[self.lead], cue.stroke_end, 0.055
        middle = path.aim.copy()
        for turn in range(int(self.rng.integers(4, 7))):
            aim = middle.copy()
            sign = 1.0 if turn % 2 == 0 else -1.0
            aim[0] += sign * reach
            aim[4] += sign * -0.18
            path.move(time, time + 0.21, aim)
            time, reach = time + 0.19, reach * 0.9
        path.move(time, time + 0.22, middle)
        self.free_at = time + 0.1

    def _moving(self) -> list[int]:
        """The hands that make this stroke; sometimes the second one rests."""
        if self.up[1 - self.lead] and self.second and self.rng.random() < 0.85:
            return [self.lead, 1 - self.lead]
        return [self.lead]

    def _sink(self, end: float, share: float) -> None:
        """Move raised hands a share of the way to rest."""
        for side, path in enumerate(self.hands):
            if self.up[side]:
                begin = end + SINK_AFTER + float(self.rng.uniform(0.0, 0.06))
                path.move(begin, begin + 0.45, path.aim + share * (self.rest[side] - path.aim))

    def _retract(self, end: float) -> None:
        """Sink, then drop to rest, in about 0.8 s; sometimes a little later."""
        end = max(end, min(self.free_at, end + 0.20))
        self._sink(end, 0.25)
        late = float(self.rng.uniform(0.2, 0.45)) if self.rng.random() < 0.12 else 0.0
        for side, path in enumerate(self.hands):
            if self.up[side]:
                begin = end + REST_AFTER + late + float(self.rng.uniform(0.0, 0.06))
                path.move(begin, begin + 0.52, self.rest[side], SINKING)
            self.up[side] = False


def with_following_torso(controls: Controls, resting: Float[Array, "t 2 14"], active: Float[Array, " t"]) -> Controls:
    """The same motion with clavicles and torso following the hands: shoulders lift and reach, the chest turns."""
    wrist, rest = controls.wrist, resting[..., WRIST]
    high = np.clip(wrist[..., 1] + 0.15, 0, 0.6)
    forward = np.clip(wrist[..., 2] - 0.28, -0.1, 0.3)
    clavicle = np.stack([0.45 * high + 0.10 * np.clip(wrist[..., 0] - 0.2, 0, 1), 0.6 * forward], axis=-1)
    shoulder = controls.shoulder + critically_damped(clavicle.astype(np.float32), 0.22)
    moved = critically_damped((wrist - rest).astype(np.float32), 0.40)
    turn = 0.22 * (moved[:, LEFT, 0] - moved[:, RIGHT, 0]) - 0.16 * (moved[:, LEFT, 2] - moved[:, RIGHT, 2])
    spine = controls.spine.copy()
    spine[:, 0] += turn
    spine[:, 1] += 0.03 * critically_damped(active, 0.8)
    spine[:, 2] -= 0.05 * (moved[:, LEFT, 1] - moved[:, RIGHT, 1])
    head = controls.head.copy()
    head[:, 0] -= 0.6 * turn
    return replace(controls, shoulder=shoulder, spine=spine, head=head)
