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

from echoavatar.models.generator.manner import Manner, draw_manner
from echoavatar.timing import FRAME_RATE_HZ
from echoavatar_lab.corpora.capture.library import CapturedLibrary, gesture_units
from echoavatar_lab.corpora.capture.units import ACCENT, GestureUnit

from ..controls import Array, Controls, blended, critically_damped, smoothed, wander
from ..sound import SoundTrack
from .gesture_cues import Cue, gesture_cues
from .handpath import FINGERS, PALM, WRIST, HandPath
from .handshapes import count_shape, hand_shape
from .head_motion import head_accents
from .idle import finger_drift, idle, resting_hands, with_hands
from .lexicon import ACCENTS, HOME, MEANINGS, Form, aim_at, home_of, in_gesture_space, meant_form
from .speakers import arousal, energy_of, pace_of, resting_of

SINK_AFTER, REST_AFTER = 0.10, 0.30  # seconds after a phrase: the hands relax, then drop
SHORTEST_SINK_GAP = 0.9  # seconds; in shorter pauses the hands wait
PATIENCE_S = 2.2  # so much later drop the hands of those who hold them up the longest
LOW = np.array([-0.045, -0.310, 0.170], np.float32)  # wrist of a raised hand that does not lead
RISING, SINKING = np.array([0.03, 0.0, 0.05], np.float32), np.array([0.03, 0.0, 0.02], np.float32)
LAUNCH_S = -0.06  # from the vowel's centre to the start of a stroke, which is about the start of the vowel
LATE_S = 0.12  # by which the second hand comes later at most, if it is no mirror image
MINOR = 0.15  # prominence from which a syllable may set off a move between two strokes
DRIFT_M = 0.013  # deviation of the hands' slow drift while they are raised
UNITS = 0.35  # chance of a captured gesture where one fits
UNIT_LATE_S = 0.6  # by which it may end after the phrase
AIM_HELD_S = 0.3, 0.8  # a large gesture stays where it ended; then the hand comes nearer to the body again
BACK_S = 0.36  # duration of a beat's return, right after its stroke
POSTURE_S = 1.4  # between two postures of a speaker, about
POSTURE = (0.10, 0.065, 0.040, 0.050)  # deviation of postures by rule: yaw, pitch, roll of the spine, pitch of the hips
POSTURE_CAPTURED = (0.05, 0.080, 0.0, 0.060)  # over a captured body, which turns and tilts by itself
LIFT = 0.18  # radians a metre by which the shoulder rises with its hand
HURRY, CLOCK_S = 1.5, 2.5  # by how much moving hands hurry the body's clock; seconds over which it is right
TYPICAL_M_S = 0.35  # speed of a hand that is half active
FOLLOW_S = 0.2
TURN = (0.32, 0.14, -0.36)  # radians a metre by which the chest turns left as the left hand goes out, up and forwards
BOW, TILT = 0.12, 0.06  # the same of bowing as the hands sink, and of the shoulder of a rising hand
STEADY = 0.8  # of the trunk's turns and bows is taken back by the head
GAZE = -0.30, 0.35  # radians, downwards
LEFT, RIGHT = 0, 1


def gesture(
    track: SoundTrack, seed: int, library: CapturedLibrary | None = None, manner: Manner | None = None
) -> Controls:
    """Idle motion for the whole track with gesture units over every phrase; captured bodies if there is a library.

    The `manner` is the seed's if there is none.
    """
    manner, rng = manner or draw_manner(seed), np.random.default_rng([seed, 3])
    body = idle(track, seed, library, manner)
    frames = len(body)
    speaker = _Speaker(manner, rng, gesture_units(library) if library is not None else ())
    starts = [begin for begin, _ in track.phrases] + [np.inf]
    for phrase, following in zip(track.phrases, starts[1:], strict=True):
        excited = arousal(track, phrase)
        minor = [s.vowel for s in track.syllables if phrase[0] <= s.vowel < phrase[1] and s.prominence > MINOR]
        cues = gesture_cues(track, phrase, pace_of(manner) * excited**0.5, rng)
        speaker.say(phrase, cues, following, energy_of(manner) * excited, minor)
    moved = smoothed(np.stack([path.curve(frames) for path in speaker.hands], axis=1), 0.03) - speaker.rest
    lively = np.clip(np.abs(moved[..., :3]).sum(-1) / 0.2, 0, 1)[..., None]
    moved[..., FINGERS] += finger_drift(frames, rng) * (0.4 + 0.8 * lively)
    drift = 0.6 * wander(frames, 6, period=1.1, rng=rng) + wander(frames, 6, period=2.4, rng=rng)
    moved[..., :3] += drift.reshape(frames, 2, 3) * DRIFT_M * energy_of(manner) * lively
    if library is not None:
        body = with_clock_of(body, moved[..., :3])
    head, spine = head_accents(track, energy_of(manner), rng)
    posture, hinge = postures(track, manner, rng, POSTURE if library is None else POSTURE_CAPTURED)
    turned = body.pelvis_rotation + hinge * np.array([0.0, 1.0, 0.0], np.float32)
    resting = body.hands()
    speaking = replace(body, spine=body.spine + spine + posture, pelvis_rotation=turned, head=body.head + head)
    speaking = with_following_torso(with_hands(speaking, resting + moved), resting, manner)
    return with_steady_head(speaking, body)


def with_clock_of(body: Controls, hands: Float[Array, "t 2 3"]) -> Controls:
    """The same body, hurried while the hands move and slowed while they rest: people's trunks move when hands do.

    Its clock never runs backwards, and is right again when averaged over seconds.
    """
    speed = np.linalg.norm(np.gradient(smoothed(hands, 0.05), axis=0), axis=-1).max(1) * FRAME_RATE_HZ
    activity = smoothed(speed / (speed + TYPICAL_M_S), 0.12)
    shift = np.cumsum(HURRY * (activity - smoothed(activity, CLOCK_S)))
    at = np.clip(np.maximum.accumulate(np.arange(len(body)) + shift), 0, len(body) - 1)
    first = np.minimum(at.astype(int), len(body) - 2)
    return blended(body[first], body[first + 1], (at - first).astype(np.float32))


class _Speaker:
    """Plans the paths of both hands phrase by phrase, and remembers which hand leads and where its home is."""

    def __init__(self, manner: Manner, rng: np.random.Generator, units: tuple[GestureUnit, ...]) -> None:
        self.manner, self.rng, self.units = manner, rng, units
        self.rest = resting_hands(resting_of(manner))
        self.hands = [HandPath(rest.copy()) for rest in self.rest]
        self.energy = energy_of(manner)
        self.up = [False, False]
        taste = rng.dirichlet(np.full(len(ACCENTS), 1.4))
        self.taste = 0.5 * taste + 0.5 / len(ACCENTS)
        self.homes = [home_of(manner, rng), home_of(manner, rng)]
        self.free_at = 0.0
        self._choose_hands()

    def say(
        self, phrase: tuple[float, float], cues: list[Cue], following: float, energy: float, minor: list[float]
    ) -> None:
        """Plan one gesture unit: rise, strokes with moves between them, and retraction after it."""
        begin, end = phrase
        self.energy = energy
        if self.rng.random() > 0.5 * self.manner.hold:
            self._choose_hands()
        if cues and self.rng.random() > 0.04 + 0.5 * (1 - self.manner.liveliness) ** 3:
            self._raise(begin, cues[0])
            for cue, after in zip(cues, [*cues[1:], None], strict=True):
                if cue.stroke_end > self.free_at:
                    self._do(cue, end)
                    self._go_on(cue, min(after.vowel if after else end, end), minor)
        for side in range(2):
            self._rest(side, end, following - end)

    def _choose_hands(self) -> None:
        """Draw which hands work in the next phrases (both, one, or one after the other) and where their homes are."""
        rng, manner = self.rng, self.manner
        self.lead = RIGHT if rng.random() < manner.right else LEFT
        self.is_both = bool(rng.random() < manner.both)
        self.takes_turns = not self.is_both and bool(rng.random() < 0.4)
        self.is_mirrored = bool(rng.random() < manner.mirror)
        self.second = float(rng.uniform(0.7, 1.0) if self.is_mirrored else rng.uniform(0.3, 1.0))
        self.homes = [home_of(manner, rng) for _ in self.hands]
        self.ways = [self._beat_way() for _ in self.hands]
        if self.is_mirrored:
            self.homes[1 - self.lead] = self.homes[self.lead] + rng.normal(0, 0.02, 14).astype(np.float32)
            self.ways = [self.ways[self.lead]] * 2
        elif not (self.is_both or self.takes_turns):
            self.homes[1 - self.lead][WRIST] = LOW + rng.normal(0, 0.03, 3)

    def _late(self, side: int) -> float:
        """Seconds by which a hand comes after the one that leads."""
        return 0.0 if side == self.lead or self.is_mirrored else float(self.rng.uniform(0.0, LATE_S))

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
        """Raise the hands that will work, in an arc away from the body; a raised one that will not may go to rest."""
        for side in (self.lead, 1 - self.lead):
            start = begin + float(self.rng.uniform(0.0, 0.10)) + 3 * self._late(side)
            length = float(np.clip(first.stroke_end - start - 0.15, 0.45, 0.75))
            if side == self.lead or self.is_both:
                arc = RISING if not self.up[side] else None
                self.hands[side].move(start, start + length, self.homes[side], arc)
                self.up[side] = True
            elif self.up[side] and self.rng.random() > self.manner.hold:
                self.hands[side].move(start, start + 0.6, self.rest[side], SINKING)
                self.up[side] = False

    def _do(self, cue: Cue, phrase_end: float) -> None:
        """Answer a cue; where hands take turns, the other one may lead from now on."""
        if self.takes_turns and self.rng.random() < 0.4:
            self.lead = 1 - self.lead
        is_large = not self.up[self.lead] or self.rng.random() < 0.15 + 0.45 * cue.weight
        meaning = meant_form(cue.meaning, cue.word) if cue.meaning else ACCENT
        if (cue.meaning or is_large) and self._unit(cue, meaning, phrase_end):
            return
        if cue.meaning:
            self._mean(cue, phrase_end)
        elif is_large:
            self._accent(cue)
        else:
            self._beat(cue)

    def _unit(self, cue: Cue, meaning: str, phrase_end: float) -> bool:
        """Often a gesture of captured people or animators, if one fits the meaning, the hands and the time left."""
        left = phrase_end + UNIT_LATE_S - cue.vowel
        fits = [u for u in self.units if u.meaning == meaning and u.seconds < left]
        if meaning == ACCENT:
            fits = [unit for unit in fits if unit.is_both == self.is_both]
        if not fits or self.rng.random() > UNITS:
            return False
        unit = fits[self.rng.integers(len(fits))]
        begin, end = cue.vowel + LAUNCH_S, cue.vowel + LAUNCH_S + unit.seconds
        size = float(np.clip(0.5 + 0.5 * self.energy, 0.65, 1.15))
        for number, side in enumerate((self.lead, 1 - self.lead) if unit.is_both else (self.lead,)):
            curve = unit.hands[:, number].copy()
            curve[:, WRIST] = np.array(HOME) + size * (curve[:, WRIST] - np.array(HOME))
            self.hands[side].follow(begin, curve, min(0.5, 0.4 * unit.seconds))
            self.hands[side].move(end - 0.2, end + 0.3, self.homes[side])
            self.up[side] = True
        self.free_at = end - 0.1
        return True

    def _beat(self, cue: Cue) -> None:
        """Move with the vowel, and partly back at once."""
        size = (0.11 + 0.20 * cue.weight**1.3) * self.energy * float(np.exp(self.rng.normal(0, 0.30)))
        for side in self._moving():
            share = size * (1.0 if side == self.lead else self.second * float(self.rng.uniform(0.7, 1.1)))
            home, way, late = self.homes[side], self.ways[side] + self.rng.normal(0, 0.15, 3), self._late(side)
            high, low = home.copy(), home.copy()
            high[WRIST] = in_gesture_space(high[WRIST] - way * share * 0.50)
            high[PALM] += (0.35 * share / 0.1 * -0.5, 0.10 * share / 0.1, 0.0)
            low[WRIST] += way * share * 0.50
            low[WRIST] = in_gesture_space(low[WRIST])
            low[PALM] += self.rng.normal(0, 0.10, 3) + (0.08, -0.10 * share / 0.1, 0.0)
            low[FINGERS] += self.rng.normal(0, 0.05, 7)
            path, end = self.hands[side], cue.stroke_end + late
            path.move(cue.vowel + LAUNCH_S + late, end, low)
            path.move(end, end + BACK_S, high)
        self.homes[self.lead][WRIST] += self.rng.normal(0, 0.02, 3)

    def _go_on(self, cue: Cue, until: float, minor: list[float]) -> None:
        """After a stroke a raised hand may wait, or go on to new places: each move is set off by a lesser syllable."""
        for side in range(2):
            free = max(cue.stroke_end, self.free_at) + 0.7 * BACK_S
            waits = 0.1 + 0.5 * self.manner.hold if side == self.lead or self.is_both else 0.9
            for vowel in minor:
                if not (self.up[side] and free < vowel < until - 0.2) or self.rng.random() < waits:
                    continue
                aim = self.homes[side].copy()
                aim[WRIST] += self.rng.normal(0, (0.085, 0.085, 0.06)) * self.energy
                aim[WRIST] = in_gesture_space(aim[WRIST])
                aim[PALM] += self.rng.normal(0, (0.15, 0.08, 0.25))
                aim[FINGERS] += self.rng.normal(0, 0.05, 7)
                end = vowel + float(self.rng.uniform(0.16, 0.32))
                arc = self.rng.normal(0, 0.03, 3)
                self.hands[side].move(vowel + LAUNCH_S, end, aim, arc.astype(np.float32))
                self.homes[side][:6] = 0.6 * self.homes[side][:6] + 0.4 * aim[:6]
                free = end + 0.10 / pace_of(self.manner)

    def _accent(self, cue: Cue) -> None:
        """A larger gesture for the phrase's nucleus; the hand's home moves there."""
        names = list(ACCENTS)
        form = ACCENTS[names[self.rng.choice(len(names), p=self.taste)]]
        size = 1.4 * self.energy * float(np.exp(self.rng.normal(0, 0.25)))
        for side in self._moving():
            self._reach(side, cue, form, size * (1.0 if side == self.lead else self.second))

    def _mean(self, cue: Cue, phrase_end: float) -> None:
        """The gesture for a word's meaning, held for a moment."""
        name = meant_form(cue.meaning, cue.word)
        form, size = MEANINGS[name], float(self.rng.uniform(0.95, 1.25)) * (0.8 + 0.6 * self.manner.space)
        two_handed = name in ("size", "small", "question") or (name == "negation" and self.rng.random() < 0.5)
        if name == "contrast":
            self.lead = 1 - self.lead
        if name == "count":
            form = replace(form, shape=count_shape(cue.word))
        sides = [LEFT, RIGHT] if two_handed else [self.lead]
        if name == "negation":
            self._inwards(cue, sides)
        for side in sides:
            self._reach(side, cue, form, size)
        if name == "greeting":
            self._wave(cue)
        self.free_at = cue.stroke_end + (0.35 if name in ("size", "count", "there", "question") else 0.15)

    def _inwards(self, cue: Cue, sides: list[int]) -> None:
        """Move hands to the middle before they wipe outwards."""
        for side in sides:
            inner = self.homes[side].copy()
            inner[WRIST] = (-0.05, -0.20 if side == self.lead else -0.24, 0.28)
            inner[5] = 1.0
            self.hands[side].move(cue.onset, max(cue.stroke_end - 0.14, cue.onset + 0.15), inner)

    def _reach(self, side: int, cue: Cue, form: Form, size: float) -> None:
        """A stroke along an arc from the hand's present place; it takes longer than planned if the way is long."""
        path = self.hands[side]
        aim = aim_at(form, self.homes[side], size=size, rng=self.rng)
        way = float(np.linalg.norm(aim[WRIST] - path.aim[WRIST]))
        begin = cue.vowel + LAUNCH_S + self._late(side)
        end = max(cue.stroke_end, begin + way / 1.7)
        arc = np.array(form.arc, np.float32) * min(1.5, way / 0.12)
        path.stroke(begin, end, aim, overshoot=float(self.rng.uniform(0.06, 0.14)), arc=arc)
        self.up[side] = True
        self.homes[side] = (0.3 * aim + 0.7 * home_of(self.manner, self.rng)).astype(np.float32)
        self.homes[side][FINGERS] = 0.5 * aim[FINGERS] + 0.5 * hand_shape("relaxed")
        begin = end + float(self.rng.uniform(*AIM_HELD_S))
        path.move(begin, begin + 0.5, self.homes[side])

    def _wave(self, cue: Cue) -> None:
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
        """The hands that make this stroke; sometimes the second one waits."""
        return [self.lead, 1 - self.lead] if self.is_both and self.rng.random() < 0.9 else [self.lead]

    def _rest(self, side: int, end: float, gap: float) -> None:
        """After a phrase a raised hand sinks, and drops to rest if its patience ends before the pause does."""
        drop = REST_AFTER + PATIENCE_S * self.manner.hold * float(self.rng.uniform(0.2, 1.0))
        if not self.up[side] or gap < SHORTEST_SINK_GAP:
            return
        end = max(end, min(self.free_at, end + 0.20))
        path, begin = self.hands[side], end + SINK_AFTER + float(self.rng.uniform(0.0, 0.06))
        share = 0.3 * (1 - self.manner.hold)
        path.move(begin, begin + 0.45, path.aim + share * (self.rest[side] - path.aim))
        if gap > drop:
            begin = end + drop + float(self.rng.uniform(0.0, 0.06))
            path.move(begin, begin + 0.52, self.rest[side], SINKING)
            self.up[side] = False


def postures(
    track: SoundTrack, manner: Manner, rng: np.random.Generator, size: tuple[float, ...] = POSTURE
) -> tuple[Float[Array, "t 3"], Float[Array, "t 1"]]:
    """The trunk's posture: spine (yaw, pitch, roll) and pitch of the pelvis; often a new one while speaking."""
    frames = round(track.seconds * FRAME_RATE_HZ)
    goal = np.zeros((frames, 4), np.float32)
    for begin, end in track.phrases:
        for time in np.arange(begin, end, POSTURE_S):
            if rng.random() < 0.75:
                first = round(float(time) * FRAME_RATE_HZ)
                goal[first:] = rng.normal(0, size) * (0.5 + manner.liveliness)
        goal[round((end + 0.5) * FRAME_RATE_HZ) :] *= 0.3
    goal[:, 1] += 0.5 * goal[:, 3]
    leaning = critically_damped(smoothed(np.clip(goal, -0.25, 0.25), 0.1), 0.75)
    spine = leaning[:, :3] + np.array([0.0, 0.08 * (manner.bow - 0.5), 0.0], np.float32)
    return spine, leaning[:, 3:]


def with_following_torso(controls: Controls, resting: Float[Array, "t 2 14"], manner: Manner) -> Controls:
    """The same motion with clavicles and torso following the hands: shoulders lift and reach, the chest turns.

    The trunk's shares of the hands' ways are captured talkers'; how far it bows and tilts is personal.
    """
    wrist, rest = controls.wrist, resting[..., WRIST]
    high = np.clip(wrist[..., 1] - rest[..., 1], 0, 0.6)
    forward = np.clip(wrist[..., 2] - 0.28, -0.1, 0.3)
    clavicle = np.stack([LIFT * high + 0.10 * np.clip(wrist[..., 0] - 0.2, 0, 1), 0.6 * forward], axis=-1)
    shoulder = controls.shoulder + critically_damped(clavicle.astype(np.float32), 0.22)
    moved = critically_damped((wrist - rest).astype(np.float32), FOLLOW_S)
    apart, mean = moved[:, LEFT] - moved[:, RIGHT], moved.mean(1)
    spine = controls.spine.copy()
    spine[:, 0] += apart @ np.array(TURN, np.float32)
    spine[:, 1] -= 2 * BOW * manner.bow * mean[:, 1]
    spine[:, 2] += 2 * TILT * manner.tilt * apart[:, 1]
    return replace(controls, shoulder=shoulder, spine=spine)


def with_steady_head(controls: Controls, before: Controls) -> Controls:
    """The same motion with a head that stays with the listener, who is in front, while the trunk turns and bows.

    The head of the body `before` it spoke made up for its own bow, but followed its own turns.
    """
    turn = controls.pelvis_rotation[:, 0] + controls.spine[:, 0]
    bow = (controls.pelvis_rotation + controls.spine - before.pelvis_rotation - before.spine)[:, 1]
    head = controls.head.copy()
    head[:, 0] -= STEADY * smoothed(np.clip(np.sin(turn), -0.7, 0.7), 0.1)
    head[:, 1] -= STEADY * smoothed(bow, 0.1)
    gaze = controls.pelvis_rotation[:, 1] + controls.spine[:, 1] + head[:, 1]
    head[:, 1] += np.clip(gaze, *GAZE) - gaze
    return replace(controls, head=head)
