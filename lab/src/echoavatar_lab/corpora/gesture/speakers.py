"""Speakers: how different people stand and gesture, as data, and how a voice raises or calms it.

One style is drawn per performance and varied a little. Sizes and rates reach the range of captured speakers
(`evaluation.captured_people`). Not in the paper, which trains on recorded speakers.
"""

from dataclasses import dataclass, replace

import numpy as np

from echoavatar.timing import SAMPLE_RATE_HZ

from ..sound import SoundTrack


@dataclass(frozen=True)
class Manner:
    """How one person moves.

    Attributes:
        name: of the style.
        energy: size of gestures; 1 is a person in conversation.
        pace: above 1, more syllables get a gesture.
        both: share of phrases in which both hands gesture.
        mirror: share of those in which the second hand mirrors the first; otherwise each goes its own way.
        handed: probability that a one-handed gesture uses the right hand.
        height, width, reach: offset of the gesture space from the usual: up, outwards and forwards, metres.
        spread: size of the gesture space.
        hold: probability that a hand waits after a stroke; otherwise it goes on to a new place.
        arc: curvature of paths.
        trunk: by how much the trunk takes part.
        nod: size of head accents.
        posture: pitch of the trunk, radians; above 0 bows forwards.
        shift_every_s, step_every_s: mean time between shifts of the weight and between new stances while speaking.
        roam: deviation of stances from the middle, metres.
        rest: where the hands rest: "sides", "clasped", "hips" or "behind".
        breath_hz: breaths a second.
    """

    name: str = "usual"
    energy: float = 1.0
    pace: float = 1.0
    both: float = 0.85
    mirror: float = 0.6
    handed: float = 0.75
    height: float = 0.0
    width: float = 0.0
    reach: float = 0.0
    spread: float = 1.0
    hold: float = 0.2
    arc: float = 1.0
    trunk: float = 1.0
    nod: float = 1.0
    posture: float = 0.0
    shift_every_s: float = 2.4
    step_every_s: float = 2.2
    roam: float = 0.14
    rest: str = "sides"
    breath_hz: float = 0.25


SPEAKERS: tuple[Manner, ...] = (
    Manner("usual"),
    Manner("calm", energy=0.72, pace=0.85, both=0.68, hold=0.35, trunk=0.7, nod=0.8, shift_every_s=4.5,
           step_every_s=4.1, roam=0.08),
    Manner("lively", energy=1.25, pace=1.15, both=0.88, spread=1.2, hold=0.10, trunk=1.3, step_every_s=1.6,
           roam=0.17),
    Manner("storyteller", energy=1.2, both=0.88, mirror=0.35, width=0.03, height=0.05, spread=1.35, hold=0.21,
           arc=1.6, trunk=1.4, nod=1.2, roam=0.18),
    Manner("lecturer", energy=0.95, pace=1.1, both=0.73, mirror=0.5, height=0.05, reach=0.03, hold=0.28, nod=1.1,
           posture=0.02, rest="clasped"),
    Manner("salesman", energy=1.2, pace=1.1, both=0.95, mirror=0.8, reach=0.05, spread=1.1, hold=0.17, trunk=1.2,
           posture=0.05, step_every_s=1.8),
    Manner("politician", energy=1.05, both=0.88, mirror=0.75, height=0.06, reach=0.04, hold=0.32, arc=0.6, nod=1.2),
    Manner("teacher of children", energy=1.3, pace=0.95, both=0.95, mirror=0.7, height=0.08, spread=1.3, arc=1.5,
           trunk=1.3, nod=1.4, posture=0.06),
    Manner("scientist", energy=0.85, pace=1.05, both=0.78, mirror=0.3, width=-0.02, reach=0.02, spread=0.85,
           hold=0.24, rest="clasped"),
    Manner("host", energy=1.1, both=0.93, mirror=0.6, width=0.04, spread=1.25, arc=1.3, trunk=1.2,
           step_every_s=1.8, roam=0.18),
    Manner("left-handed", handed=0.2),
    Manner("left-handed, lively", energy=1.2, pace=1.1, handed=0.22, both=0.73, spread=1.2, hold=0.14, trunk=1.25),
    Manner("one-handed", both=0.43, energy=1.1, hold=0.21, rest="hips"),
    Manner("wide", width=0.07, spread=1.3, arc=1.3, both=0.93, trunk=1.15),
    Manner("narrow", width=-0.03, spread=0.8, energy=0.85, both=0.88, rest="clasped"),
    Manner("high", height=0.10, both=0.78, energy=1.05, hold=0.17),
    Manner("low", height=-0.07, energy=0.85, both=0.78, hold=0.21, arc=0.8),
    Manner("choppy", energy=1.05, pace=1.15, arc=0.4, hold=0.35, both=0.78, mirror=0.7, nod=1.3),
    Manner("flowing", arc=1.8, hold=0.07, both=0.93, mirror=0.45, spread=1.2, trunk=1.3, nod=0.8),
    Manner("restless", energy=1.1, pace=1.1, hold=0.07, shift_every_s=2.0, step_every_s=1.2, roam=0.22, trunk=1.2),
    Manner("reserved", energy=0.65, pace=0.8, both=0.58, spread=0.8, hold=0.32, trunk=0.6, nod=0.8,
           shift_every_s=5.0, step_every_s=5.5, roam=0.07, rest="clasped"),
    Manner("confident", both=0.83, width=0.03, reach=0.02, hold=0.32, arc=1.1, posture=-0.04, rest="hips",
           step_every_s=2.7),
    Manner("shy", energy=0.7, pace=0.9, width=-0.04, height=-0.05, spread=0.75, hold=0.21, nod=1.2, posture=0.05,
           rest="clasped", step_every_s=2.7, roam=0.07),
    Manner("preacher", energy=1.35, pace=0.95, both=0.93, mirror=0.7, height=0.12, spread=1.4, hold=0.28,
           trunk=1.5, nod=1.3, posture=0.03),
    Manner("walker", energy=1.0, step_every_s=1.1, shift_every_s=2.4, roam=0.26, hold=0.17, trunk=1.1, rest="behind"),
)  # fmt: skip


def draw_manner(seed: int) -> Manner:
    """The manner that follows from a performance's seed: a style with sizes of its own."""
    rng = np.random.default_rng([seed, 1])
    style = SPEAKERS[rng.integers(len(SPEAKERS))]
    return replace(
        style,
        energy=style.energy * float(rng.uniform(1.0, 1.35)),
        pace=style.pace * float(rng.uniform(0.93, 1.08)),
        spread=style.spread * float(rng.uniform(1.0, 1.3)),
        height=style.height + float(rng.normal(0, 0.02)),
        width=style.width + float(rng.normal(0, 0.015)),
        handed=1 - style.handed if rng.random() < 0.1 else style.handed,
        nod=style.nod * float(rng.uniform(0.8, 1.2)),
        breath_hz=float(rng.uniform(0.21, 0.30)),
    )


def arousal(track: SoundTrack, phrase: tuple[float, float]) -> float:
    """How excited a phrase sounds, about 0.7 (slow, even, dull) to 1.35: it scales the size and rate of gestures.

    What counts is what is heard whatever the recording's level: syllables a second, the range of loudness between
    them, and the share of high frequencies.
    """
    begin, end = phrase
    inside = [s for s in track.syllables if begin - 0.02 <= s.vowel < end]
    audio = track.audio[round(begin * SAMPLE_RATE_HZ) : round(end * SAMPLE_RATE_HZ)].astype(np.float64)
    if len(inside) < 3 or len(audio) < SAMPLE_RATE_HZ // 2:
        return 1.0
    rate = len(inside) / (end - begin)
    blocks = audio[: len(audio) // 600 * 600].reshape(-1, 600)
    level = 10 * np.log10((blocks**2).mean(1) + 1e-9)
    voiced = level > level.max() - 30
    change = np.diff(blocks, axis=1)
    bright = float(np.log((change[voiced] ** 2).sum() / max((blocks[voiced] ** 2).sum(), 1e-9) + 1e-6))
    excited = 0.12 * (rate - 4.5) + 0.02 * (float(level[voiced].std()) - 6.5) + 0.10 * (bright + 3.2)
    return float(np.clip(1.0 + excited, 0.7, 1.35))
