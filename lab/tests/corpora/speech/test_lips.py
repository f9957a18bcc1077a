import numpy as np
import pytest

from echoavatar.motion.arkit import ARKIT_NAMES, mouth_opening
from echoavatar_lab.corpora.rehearsal.track import compose_track
from echoavatar_lab.corpora.sound import SoundTrack, Syllable
from echoavatar_lab.corpora.speech.lips import lip_curves


def spoken(*phones: tuple[float, float, str], seconds: float = 2.0, **labels: object) -> np.ndarray:
    track = SoundTrack(np.zeros(int(seconds * 24_000), np.float32), phones=phones, **labels)
    return lip_curves(track, ARKIT_NAMES)


def at(curves: np.ndarray, name: str, second: float) -> float:
    return float(curves[int(second * 30), ARKIT_NAMES.index(name)])


@pytest.fixture(scope="module")
def track() -> SoundTrack:
    return compose_track(3, 20, "speech", engine="own")


@pytest.fixture(scope="module")
def curves(track: SoundTrack) -> np.ndarray:
    return lip_curves(track, ARKIT_NAMES)


def test_one_row_per_frame_between_0_and_1(track, curves):
    assert curves.shape == (len(track.audio) // 800, 52)
    assert curves.dtype == np.float32
    assert curves.min() >= 0
    assert curves.max() <= 1


def test_lips_are_closed_on_p_b_m():
    """Between wide vowels, 55 to 110 ms long, at any phase of the frames."""
    rng, phones, now = np.random.default_rng(0), [], 0.3
    while now < 29:
        for name, length in (("ae", 0.12), (str(rng.choice(["p", "b", "m"])), rng.uniform(0.055, 0.11))):
            phones.append((now, now + length, name))
            now += length
    opening, closed = mouth_opening(spoken(*phones, seconds=30)), []
    for start, end, name in phones:
        if name != "ae":
            middle = (start + end) / 2
            closed.append(opening[int(middle * 30)] < 0.03)
    assert np.mean(closed) > 0.95
    assert opening[30:800].max() > 0.35


def test_vowels_open_more_than_other_phones_and_silence_is_still(track, curves):
    opening = mouth_opening(curves)

    def mean(names: str) -> float:
        spots = [round((a + b) * 15) for a, b, name in track.phones if name in names.split() and b < 19.9]
        return float(np.mean(opening[spots]))

    assert mean("aa ae ah ao") > 2 * mean("s z t d n sh")
    speech = np.zeros(len(curves), bool)
    for start, end, _ in track.phones:
        speech[int(start * 30) - 6 : int(end * 30) + 7] = True
    assert (~speech).sum() > 20
    assert curves[~speech].max() < 0.02


def test_it_is_smooth(curves):
    """A mouth opens fully in about a tenth of a second; no channel changes faster."""
    assert np.abs(np.diff(curves, axis=0)).max() < 0.3
    assert np.abs(np.diff(curves, 2, axis=0)).mean() < 0.02


def test_the_jaw_is_widest_in_the_middle_of_the_vowel():
    """aa from 0.9 to 1.1 s: the widest frame is the 30th, whose middle lies at 1.017 s, or its neighbour."""
    curves = spoken((0.8, 0.9, "t"), (0.9, 1.1, "aa"), (1.1, 1.2, "t"))
    assert int(curves[:, ARKIT_NAMES.index("jawOpen")].argmax()) in (29, 30)


def test_rounding_begins_before_the_vowel():
    """In s-uw the lips round during the s; in s-iy they do not."""
    rounded = spoken((0.9, 1.0, "s"), (1.0, 1.2, "uw"))
    spread = spoken((0.9, 1.0, "s"), (1.0, 1.2, "iy"))
    assert at(rounded, "mouthPucker", 0.97) > 0.1
    assert at(spread, "mouthPucker", 0.97) < 0.02
    assert at(spread, "mouthStretchLeft", 1.1) > 0.25


def test_prominence_opens_the_jaw():
    def jaw(prominence: float) -> float:
        syllable = Syllable(0.9, 1.1, 1.0, prominence, "ah", "")
        return at(spoken((0.9, 1.1, "aa"), syllables=(syllable,)), "jawOpen", 1.0)

    assert jaw(1.0) > 1.4 * jaw(0.0)


def test_f_bites_the_lower_lip_and_an_unknown_phone_is_a_neutral_vowel():
    bite = spoken((0.9, 1.0, "ae"), (1.0, 1.1, "f"), (1.1, 1.2, "ae"))
    assert at(bite, "mouthRollLower", 1.05) > 0.25
    assert at(bite, "mouthRollUpper", 1.05) < 0.05
    np.testing.assert_array_equal(spoken((0.9, 1.1, "qq")), spoken((0.9, 1.1, "ax")))


def test_the_caller_chooses_names_and_order(track, curves):
    some = lip_curves(track, ("jawOpen", "mouthPucker", "eyeBlinkLeft"))
    assert np.array_equal(some[:, 0], curves[:, ARKIT_NAMES.index("jawOpen")])
    assert np.array_equal(some[:, 1], curves[:, ARKIT_NAMES.index("mouthPucker")])
    assert some[:, 2].max() == 0


def test_no_phones_no_movement():
    assert spoken().max() == 0
