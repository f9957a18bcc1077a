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

from echoavatar.timing import FRAME_RATE_HZ
from echoavatar_lab.corpora.capture.library import CapturedLibrary

from ..controls import Array, Controls, critically_damped, smoothed, wander
from ..sound import SoundTrack
from .gesture_cues import Cue, gesture_cues
from .handpath import FINGERS, PALM, WRIST, HandPath
from .handshapes import count_shape, hand_shape
from .head_motion import head_accents, speech_activity
from .idle import finger_drift, hands_of, idle, resting_hands, with_hands
from .lexicon import ACCENTS, MEANINGS, Form, aim_at, home_of, in_gesture_space, meant_form
from .speakers import Manner, arousal, draw_manner

SINK_AFTER, REST_AFTER = 0.10, 0.30  # seconds after a phrase: the hands relax, then drop
SHORTEST_SINK_GAP, SHORTEST_REST_GAP = (
    0.50,
    1.35,
)  # seconds: in shorter pauses the hands wait, in longer ones they sink or go to rest
LOW = np.array([-0.045, -0.385, 0.190], np.float32)  # wrist of a raised hand that does not lead
RISING, SINKING = np.array([0.03, 0.0, 0.05], np.float32), np.array([0.03, 0.0, 0.02], np.float32)
LAUNCH_S = -0.06  # from the vowel's centre to the start of a stroke, which is about the start of the vowel
MINOR = 0.15  # prominence from which a syllable may set off a move between two strokes
DRIFT_M = 0.013  # deviation of the hands' slow drift while they are raised
BACK_S = 0.36  # duration of a beat's return, right after its stroke
CAPTURED_POSTURE = 0.3  # of the postures by rule, over a captured body that leans and turns by itself
LEFT, RIGHT = 0, 1


def gesture(track: SoundTrack, seed: int, library: CapturedLibrary | None = None) -> Controls:
    """Idle motion for the whole track with gesture units over every phrase; captured bodies if there is a library."""
    manner, rng = draw_manner(seed), np.random.default_rng([seed, 3])
    body = idle(track, seed, library)
    frames = len(body)
    rest = resting_hands(manner.rest)
    speaker = _Speaker(manner, rng, [HandPath(rest[LEFT].copy()), HandPath(rest[RIGHT].copy())], rest)
    starts = [begin for begin, _ in track.phrases] + [np.inf]
    for phrase, following in zip(track.phrases, starts[1:], strict=True):
        excited = arousal(track, phrase)
        eager = replace(manner, energy=manner.energy * excited, pace=manner.pace * excited**0.5)
        minor = [s.vowel for s in track.syllables if phrase[0] <= s.vowel < phrase[1] and s.prominence > MINOR]
        speaker.say(phrase, gesture_cues(track, phrase, eager, rng), following, eager, minor)
    moved = smoothed(np.stack([path.curve(frames) for path in speaker.hands], axis=1), 0.03) - rest
    active = speech_activity(track, frames)
    lively = np.clip(np.abs(moved[..., :3]).sum(-1) / 0.2, 0, 1)[..., None]
    moved[..., FINGERS] += finger_drift(frames, rng) * (0.4 + 0.8 * lively)
    drift = 0.6 * wander(frames, 6, period=1.1, rng=rng) + wander(frames, 6, period=2.4, rng=rng)
    moved[..., :3] += drift.reshape(frames, 2, 3) * DRIFT_M * manner.energy * lively
    head, spine = head_accents(track, manner.nod, rng)
    posture, hinge = postures(track, manner, rng, size=1.0 if library is None else CAPTURED_POSTURE)
    turned = body.pelvis_rotation + hinge * np.array([0.0, 1.0, 0.0], np.float32)
    body = replace(body, head=body.head + head, spine=body.spine + spine + posture, pelvis_rotation=turned)
    return with_following_torso(with_hands(body, hands_of(body) + moved), hands_of(body), active, manner.trunk)


class _Speaker:
    """Plans the paths of both hands phrase by phrase, and remembers which hand leads and where its home is."""

    def __init__(self, manner: Manner, rng: np.random.Generator, hands: list[HandPath], rest: Array) -> None:
        self.manner, self.rng, self.hands, self.rest = manner, rng, hands, rest
        self.lead = RIGHT if rng.random() < manner.handed else LEFT
        self.second = self._role()
        self.up = [False, False]
        self.homes = [home_of(manner, rng), home_of(manner, rng)]
        taste = rng.dirichlet(np.full(len(ACCENTS), 1.4))
        self.taste = 0.5 * taste + 0.5 / len(ACCENTS)
        self.beat_way = self._beat_way()
        self.free_at = 0.0

    def say(
        self, phrase: tuple[float, float], cues: list[Cue], following: float, manner: Manner, minor: list[float]
    ) -> None:
        """Plan one gesture unit: rise, strokes with moves between them, and retraction before a long pause."""
        begin, end = phrase
        self.manner = manner
        self._choose_hands()
        if cues and self.rng.random() > 0.04:
            self._raise(begin, cues[0])
            for cue, after in zip(cues, [*cues[1:], None], strict=True):
                if cue.stroke_end > self.free_at:
                    self._do(cue, end)
                    self._go_on(cue, min(after.vowel if after else end, end), minor)
        gap = following - end
        if gap > SHORTEST_REST_GAP or (gap > SHORTEST_SINK_GAP and self.rng.random() < 0.2):
            self._retract(end)
        elif gap > SHORTEST_SINK_GAP:
            self._sink(end, 0.28)

    def _choose_hands(self) -> None:
        """Sometimes change the leading hand, the role of the second hand or the home position."""
        rng = self.rng
        if rng.random() < 0.35:
            self.lead = RIGHT if rng.random() < self.manner.handed else LEFT
        if rng.random() < 0.50:
            self.second = self._role()
        if rng.random() < 0.7:
            self.homes = [home_of(self.manner, rng) for _ in self.hands]
            if rng.random() < self.manner.mirror:
                self.homes[1 - self.lead] = self.homes[self.lead] + rng.normal(0, 0.02, 14).astype(np.float32)
            self.beat_way = self._beat_way()
        if 0 < self.second < 0.4:
            self.homes[1 - self.lead][WRIST] = LOW + rng.normal(0, 0.03, 3)

    def _role(self) -> float:
        """The share of the leading hand's movement that the second hand makes: most of it, a little, or none."""
        if self.rng.random() < self.manner.both:
            return float(self.rng.uniform(0.7, 1.05))
        return 0.35 if self.rng.random() < 0.6 else 0.0

    def _beat_way(self) -> Array:
        """The direction of the next beats: mostly down, some outwards, inwards, forwards or upwards."""
        ways = (
            (0.15, -1.0, 0.25),
            (0.6, -0.7, 0.35),
            (-0.35, -0.8, 0.25),
            (0.25, -0.45, 0.8),
            (0.9, -0.2, 0.3),
            (0.3, 0.8, 0.4),
        )
        way = np.array(ways[self.rng.choice(6, p=(0.34, 0.20, 0.12, 0.14, 0.12, 0.08))]) + self.rng.normal(0, 0.18, 3)
        return np.asarray(way / np.linalg.norm(way), np.float32)

    def _raise(self, begin: float, first: Cue) -> None:
        """Raise the hands at the start of a phrase, in an arc away from the body."""
        sides = [self.lead, 1 - self.lead] if self.second else [self.lead]
        for delay, side in zip((0.0, float(self.rng.uniform(0.0, 0.12))), sides, strict=False):
            start = begin + float(self.rng.uniform(0.0, 0.10)) + delay
            length = float(np.clip(first.stroke_end - start - 0.15, 0.45, 0.75))
            arc = RISING if not self.up[side] else None
            self.hands[side].move(start, start + length, self.homes[side], arc)
            self.up[side] = True

    def _do(self, cue: Cue, phrase_end: float) -> None:
        if cue.meaning:
            self._mean(cue, phrase_end)
        elif self.rng.random() < 0.15 + 0.45 * cue.weight:
            self._accent(cue)
        else:
            self._beat(cue)

    def _beat(self, cue: Cue) -> None:
        """Move with the vowel, and partly back at once."""
        size = (0.11 + 0.20 * cue.weight**1.3) * self.manner.energy * float(np.exp(self.rng.normal(0, 0.30)))
        for side in self._moving():
            share = size * (1.0 if side == self.lead else self.second * float(self.rng.uniform(0.7, 1.1)))
            home, way = self.homes[side], self.beat_way + self.rng.normal(0, 0.15, 3)
            high, low = home.copy(), home.copy()
            high[WRIST] = in_gesture_space(high[WRIST] - way * share * 0.50)
            high[PALM] += (0.35 * share / 0.1 * -0.5, 0.10 * share / 0.1, 0.0)
            low[WRIST] += way * share * 0.50
            low[WRIST] = in_gesture_space(low[WRIST])
            low[PALM] += self.rng.normal(0, 0.10, 3) + (0.08, -0.10 * share / 0.1, 0.0)
            low[FINGERS] += self.rng.normal(0, 0.05, 7)
            path, end = self.hands[side], cue.stroke_end
            path.move(cue.vowel + LAUNCH_S, end, low)
            path.move(end, end + BACK_S, high)
        self.homes[self.lead][WRIST] += self.rng.normal(0, 0.02, 3)

    def _go_on(self, cue: Cue, until: float, minor: list[float]) -> None:
        """After a stroke a raised hand may wait, or go on to new places: each move is set off by a lesser syllable."""
        for side in range(2):
            free = max(cue.stroke_end, self.free_at) + 0.7 * BACK_S
            for vowel in minor:
                if not (self.up[side] and free < vowel < until - 0.2) or self.rng.random() < self.manner.hold:
                    continue
                aim = self.homes[side].copy()
                aim[WRIST] += self.rng.normal(0, (0.085, 0.085, 0.06)) * self.manner.spread * self.manner.energy
                aim[WRIST] = in_gesture_space(aim[WRIST])
                aim[PALM] += self.rng.normal(0, (0.15, 0.08, 0.25))
                aim[FINGERS] += self.rng.normal(0, 0.05, 7)
                end = vowel + float(self.rng.uniform(0.16, 0.32))
                arc = self.rng.normal(0, 0.03, 3) * self.manner.arc
                self.hands[side].move(vowel + LAUNCH_S, end, aim, arc.astype(np.float32))
                self.homes[side][:6] = 0.6 * self.homes[side][:6] + 0.4 * aim[:6]
                free = end + 0.10 / self.manner.pace

    def _accent(self, cue: Cue) -> None:
        """A larger gesture for the phrase's nucleus; the hand's home moves there."""
        names = list(ACCENTS)
        form = ACCENTS[names[self.rng.choice(len(names), p=self.taste)]]
        size = 1.5 * self.manner.energy * float(np.exp(self.rng.normal(0, 0.25)))
        for side in self._moving() if self.second > 0.4 else [self.lead]:
            self._reach(side, cue, form, size * (1.0 if side == self.lead else self.second))

    def _mean(self, cue: Cue, phrase_end: float) -> None:
        """The gesture for a word's meaning, held for a moment."""
        name = meant_form(cue.meaning, cue.word)
        form, size = MEANINGS[name], self.manner.spread * float(self.rng.uniform(0.95, 1.25))
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
        aim = aim_at(form, self.homes[side], size=size, rng=self.rng)
        way = float(np.linalg.norm(aim[WRIST] - path.aim[WRIST]))
        begin = cue.vowel + LAUNCH_S
        end = max(cue.stroke_end, begin + way / 2.0)
        arc = np.array(form.arc, np.float32) * min(1.5, way / 0.12) * self.manner.arc
        path.stroke(begin, end, aim, overshoot=float(self.rng.uniform(0.06, 0.14)), arc=arc)
        self.up[side] = True
        self.homes[side] = (0.5 * aim + 0.5 * home_of(self.manner, self.rng)).astype(np.float32)
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
        if self.up[1 - self.lead] and self.second and self.rng.random() < 0.93:
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


def postures(
    track: SoundTrack, manner: Manner, rng: np.random.Generator, size: float = 1.0
) -> tuple[Float[Array, "t 3"], Float[Array, "t 1"]]:
    """The trunk's posture: spine (yaw, pitch, roll) and pitch of the pelvis; a new one with every second phrase."""
    frames = round(track.seconds * FRAME_RATE_HZ)
    goal = np.zeros((frames, 4), np.float32)
    for begin, end in track.phrases:
        for time in np.arange(begin, end, 2.2):
            if rng.random() < 0.75:
                first = round(float(time) * FRAME_RATE_HZ)
                goal[first:] = rng.normal(0, 1, 4) * np.array([0.10, 0.065, 0.040, 0.050]) * manner.trunk * size
        goal[round((end + 0.5) * FRAME_RATE_HZ) :] *= 0.3
    goal[:, 1] += 0.5 * goal[:, 3]
    leaning = critically_damped(smoothed(np.clip(goal, -0.25, 0.25), 0.1), 0.75)
    spine = leaning[:, :3] + np.array([0.0, manner.posture, 0.0], np.float32)
    return spine, leaning[:, 3:]


def with_following_torso(
    controls: Controls, resting: Float[Array, "t 2 14"], active: Float[Array, " t"], share: float
) -> Controls:
    """The same motion with clavicles and torso following the hands: shoulders lift and reach, the chest turns."""
    wrist, rest = controls.wrist, resting[..., WRIST]
    high = np.clip(wrist[..., 1] + 0.15, 0, 0.6)
    forward = np.clip(wrist[..., 2] - 0.28, -0.1, 0.3)
    clavicle = np.stack([0.45 * high + 0.10 * np.clip(wrist[..., 0] - 0.2, 0, 1), 0.6 * forward], axis=-1)
    shoulder = controls.shoulder + critically_damped(clavicle.astype(np.float32), 0.22)
    moved = share * critically_damped((wrist - rest).astype(np.float32), 0.40)
    turn = 0.27 * (moved[:, LEFT, 0] - moved[:, RIGHT, 0]) - 0.20 * (moved[:, LEFT, 2] - moved[:, RIGHT, 2])
    spine = controls.spine.copy()
    spine[:, 0] += turn
    spine[:, 1] += 0.03 * critically_damped(active, 0.8) + 0.10 * moved[..., 2].mean(1) - 0.06 * moved[..., 1].mean(1)
    spine[:, 2] -= 0.09 * (moved[:, LEFT, 1] - moved[:, RIGHT, 1])
    head = controls.head.copy()
    head[:, 0] -= 0.6 * turn
    return replace(controls, shoulder=shoulder, spine=spine, head=head)
