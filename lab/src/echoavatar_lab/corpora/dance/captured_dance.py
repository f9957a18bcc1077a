"""The dance to a sound track: by rule, or by captured people where the music suits them; bends are laid over both."""

import numpy as np

from echoavatar.timing import FRAME_RATE_HZ
from echoavatar_lab.corpora.capture.library import CapturedLibrary

from ..controls import Controls, concatenated
from ..sound import SoundTrack
from . import bends
from .dance import dance, danced
from .dance_graph import dance_graph
from .grooves import Counts, find_counts
from .phrases import can_dance, captured_dance

BY_RULE = 0.05  # of the pieces that captured people could dance
SALSA, STREET, MODERN = ("salsa_lead", "salsa_follow"), ("street", "keyed"), ("modern", "whirl")
DANCERS: dict[str, tuple[tuple[str, ...], ...]] = {
    "salsa": (SALSA,),
    "hip_hop": (STREET, STREET, SALSA),
    "drum_and_bass": (STREET, SALSA),
    "house": (SALSA, STREET, MODERN),
    "rock": (SALSA, STREET, MODERN),
    "pop": (SALSA, STREET, MODERN),
    "swing": (SALSA, MODERN),
    "waltz": (MODERN, SALSA),
    "ballet": (MODERN,),
    "ballad": (MODERN, SALSA),
    "rest": (),
}


def dance_to(track: SoundTrack, seed: int, library: CapturedLibrary | None = None) -> Controls:
    """Dance in the music spans of a track and stand at ease elsewhere; deterministic for a seed.

    With a library captured people dance most of the spans.
    """
    made, spans = dance(track, seed), danced(track)
    for number, span in enumerate(spans):
        counts = find_counts(track, span)
        by_rule = made
        if library is not None:
            until = spans[number + 1].start if number + 1 < len(spans) else track.seconds
            made = with_captured(made, library, counts, until, np.random.default_rng([seed, 8, number]))
        size = bends.SIZE_BY_RULE if made is by_rule else bends.SIZE_CAPTURED
        made = bends.with_bends(made, counts, np.random.default_rng([seed, 9, number]), size)
    return made


def with_captured(
    dance: Controls, library: CapturedLibrary, counts: Counts, until: float, rng: np.random.Generator
) -> Controls:
    """The same dance with captured people in one music span, if some go with the music and its tempo.

    They come to rest after the span, at `until` seconds at the latest.
    """
    dances = dance_graph(library)
    kinds = DANCERS.get(counts.groove.name, ())
    chosen = [kinds[i] for i in rng.permutation(len(kinds))]
    groups = next((groups for groups in chosen if can_dance(dances, groups, counts)), None)
    if groups is None or rng.random() < BY_RULE:
        return dance
    first, made = captured_dance(dances, groups, counts, rng)
    begin = max(round(counts.start * FRAME_RATE_HZ), first, 0)
    end = min(first + len(made), round(until * FRAME_RATE_HZ), len(dance))
    parts = (dance[:begin], made[begin - first : end - first], dance[end:])
    return concatenated([part for part in parts if len(part)])
