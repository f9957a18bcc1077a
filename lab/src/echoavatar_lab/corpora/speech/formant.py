"""A formant speech synthesiser in numpy: robotic, but free of dependencies and with exact phone times.

Pulses and noise pass through a filter of three moving formants, frame by frame in the frequency domain. It replaces
flite where that is not installed. Not in the paper.
"""

import numpy as np

from echoavatar.timing import SAMPLE_RATE_HZ

from .pronounce import VOWELS, syllabify
from .prosody import Delivery, SpokenSyllable, Utterance, lift_nuclei, score_prominence, shape_pitch
from .script import Word

VOICE = {"alto": (190.0, 1.14), "tenor": (125.0, 1.0), "bass": (95.0, 0.93)}  # pitch in Hz, formant scale
FORMANT_VOICES = tuple(VOICE)
_HOP, _FFT = 120, 1024  # 5 ms frames
_MARGIN_S = 0.03
Array = np.ndarray

# Formants in Hz; a second triple is where a diphthong ends.
_VOWEL_FORMANTS: dict[str, tuple[tuple[int, int, int], ...]] = {
    "aa": ((730, 1150, 2450),),
    "ae": ((670, 1750, 2450),),
    "ah": ((630, 1250, 2450),),
    "ao": ((580, 900, 2450),),
    "ax": ((500, 1450, 2450),),
    "eh": ((540, 1800, 2500),),
    "er": ((480, 1350, 1700),),
    "ih": ((400, 1950, 2550),),
    "iy": ((280, 2250, 2950),),
    "uh": ((440, 1050, 2300),),
    "uw": ((310, 950, 2250),),
    "aw": ((700, 1250, 2500), (430, 950, 2350)),
    "ay": ((700, 1250, 2500), (350, 2050, 2600)),
    "ey": ((480, 1900, 2500), (330, 2150, 2700)),
    "ow": ((520, 1000, 2400), (370, 850, 2300)),
    "oy": ((560, 900, 2450), (350, 2000, 2550)),
}
# Consonants: seconds, formants, voice, noise, noise centre Hz, noise width Hz.
_CONSONANTS: dict[str, tuple[float, tuple[int, int, int], float, float, float, float]] = {
    "m": (0.065, (250, 1100, 2200), 0.35, 0, 0, 1),
    "n": (0.06, (250, 1500, 2500), 0.35, 0, 0, 1),
    "ng": (0.065, (250, 1900, 2500), 0.35, 0, 0, 1),
    "l": (0.06, (360, 1100, 2700), 0.5, 0, 0, 1),
    "r": (0.06, (380, 1150, 1600), 0.5, 0, 0, 1),
    "w": (0.06, (300, 700, 2200), 0.45, 0, 0, 1),
    "y": (0.05, (280, 2200, 2900), 0.45, 0, 0, 1),
    "hh": (0.055, (550, 1500, 2500), 0.0, 0.12, 1600, 1500),
    "s": (0.095, (400, 1700, 2600), 0.0, 0.4, 6500, 1700),
    "z": (0.07, (300, 1700, 2600), 0.2, 0.25, 6500, 1700),
    "sh": (0.095, (400, 1800, 2600), 0.0, 0.4, 3400, 1100),
    "ch": (0.09, (400, 1800, 2600), 0.0, 0.4, 3600, 1200),
    "jh": (0.075, (300, 1800, 2600), 0.15, 0.3, 3300, 1200),
    "f": (0.085, (400, 1100, 2300), 0.0, 0.12, 5000, 4000),
    "v": (0.06, (300, 1100, 2300), 0.25, 0.06, 4500, 4000),
    "th": (0.08, (400, 1300, 2500), 0.0, 0.1, 6000, 3500),
    "dh": (0.045, (300, 1300, 2500), 0.3, 0.04, 5000, 3500),
    "p": (0.085, (400, 900, 2300), 0.0, 0.3, 900, 900),
    "t": (0.08, (400, 1700, 2600), 0.0, 0.35, 4500, 1800),
    "k": (0.085, (400, 1900, 2400), 0.0, 0.35, 2000, 900),
    "b": (0.065, (300, 900, 2300), 0.1, 0.15, 700, 700),
    "d": (0.06, (300, 1700, 2600), 0.1, 0.2, 4000, 1800),
    "g": (0.065, (300, 1900, 2400), 0.1, 0.2, 1900, 900),
}
_STOPS = frozenset(("p", "t", "k", "b", "d", "g", "ch", "jh"))


def say(words: tuple[Word, ...], delivery: Delivery, seed: int) -> Utterance:
    """Speak the words in one breath; the same seed gives the same samples."""
    rng = np.random.default_rng(seed)
    phones, syllables = _timing(words, delivery, rng)
    syllables = score_prominence(syllables, words)
    total = phones[-1][1] + _MARGIN_S
    frames = int(np.ceil(total * SAMPLE_RATE_HZ / _HOP)) + 1
    hertz, scale = VOICE[delivery.voice]
    plain = (hertz * np.linspace(1.12, 0.88, frames)).astype(np.float32)  # falls, as a statement does
    f0 = shape_pitch(
        plain, frame_s=_HOP / SAMPLE_RATE_HZ, syllables=syllables, delivery=delivery, is_question=words[-1].mark == "?"
    )
    scale = scale * (1 + 1.2 * (0.42 - delivery.alpha))
    raw = synthesise(phones, f0.astype(np.float64), scale, rng)[: round(total * SAMPLE_RATE_HZ)]
    level = np.asarray(0.5 * raw / max(float(np.max(np.abs(raw))), 1e-9), dtype=np.float32)
    audio = lift_nuclei(level, SAMPLE_RATE_HZ, syllables, delivery.nucleus_db)
    spoken = tuple(phone for phone in phones if phone[2] != "pau")
    return Utterance(audio, spoken, syllables)


def _timing(
    words: tuple[Word, ...], delivery: Delivery, rng: np.random.Generator
) -> tuple[list[tuple[float, float, str]], tuple[SpokenSyllable, ...]]:
    """Phone times by rule: stress, focus and the end of a phrase lengthen phones; punctuation adds a pause."""
    phones: list[tuple[float, float, str]] = []
    syllables: list[SpokenSyllable] = []
    now = _MARGIN_S
    for i, word in enumerate(words):
        parts = syllabify(word.text)
        is_last = i == len(words) - 1
        for k, (names, is_stressed) in enumerate(parts):
            start, vowel = now, now
            slow = (1.25 if word.is_focus else 1.0) * (1.35 if is_last and k == len(parts) - 1 else 1.0)
            for name in names:
                length = _length(name, is_stressed) * slow / delivery.rate * float(np.exp(rng.normal(0, 0.08)))
                phones.append((now, now + length, name))
                vowel = now + length / 2 if name in VOWELS else vowel
                now += length
            syllables.append(SpokenSyllable(start, now, vowel, i, is_stressed))
        if word.mark and not is_last:
            pause = float(rng.uniform(0.1, 0.3))
            phones.append((now, now + pause, "pau"))
            now += pause
    return phones, tuple(syllables)


def _length(name: str, is_stressed: bool) -> float:
    if name in VOWELS:
        return (0.13 if len(_VOWEL_FORMANTS[name]) == 1 else 0.16) * (1.0 if is_stressed else 0.55)
    return _CONSONANTS[name][0]


def _tracks(phones: list[tuple[float, float, str]], frames: int) -> Array:
    """Control tracks (t, 7): three formants, voice, noise, noise centre and width, smoothed over 25 ms."""
    rows = np.zeros((frames, 7))
    rows[:, :3], rows[:, 5:] = (500, 1500, 2500), (3000, 2000)
    for start, end, name in phones:
        a, b = (round(t * SAMPLE_RATE_HZ / _HOP) for t in (start, end))
        if name in VOWELS:
            first, last = np.array(_VOWEL_FORMANTS[name][0]), np.array(_VOWEL_FORMANTS[name][-1])
            rows[a:b, :3] = first + np.linspace(0, 1, max(b - a, 1))[:, None][: b - a] * (last - first)
            rows[a:b, 3] = 1.0
        elif name != "pau":
            _, formants, voice, noise, centre, width = _CONSONANTS[name]
            rows[a:b, :3], rows[a:b, 5:] = formants, (max(centre, 300), width)
            burst = a + (b - a) * 3 // 5 if name in _STOPS else a
            rows[a:b, 3], rows[burst:b, 4] = voice, noise
    smooth = np.hanning(7)[1:-1] / np.hanning(7)[1:-1].sum()
    padded = np.pad(rows, ((2, 2), (0, 0)), mode="edge")
    return np.stack([np.convolve(padded[:, k], smooth, mode="valid") for k in range(7)], axis=1)


def synthesise(phones: list[tuple[float, float, str]], f0: Array, scale: float, rng: np.random.Generator) -> Array:
    """Phones (start s, end s, name) at the pitch f0 (t,) in Hz, a value every 5 ms: audio (120 t,).

    Every frame has a pitch; the control tracks say how much it is voiced. Filtered pulses and noise are overlap-added.
    """
    frames = len(f0)
    tracks = _tracks(phones, frames)
    length = frames * _HOP
    time = np.arange(length + _FFT)
    phase = np.cumsum(np.interp(time, np.arange(frames) * _HOP, f0)) / SAMPLE_RATE_HZ
    pulses = np.diff(np.floor(phase), prepend=0.0) * np.sqrt(SAMPLE_RATE_HZ / 120)
    pulses += 0.12 * rng.standard_normal(len(time))
    hiss = rng.standard_normal(len(time))
    window = np.hanning(4 * _HOP + 1)[:-1] / 2
    places = np.arange(frames)[:, None] * _HOP + np.arange(4 * _HOP)[None, :]
    voiced = np.fft.rfft(pulses[places] * window, _FFT) * _vowel_filter(tracks[:, :3] * scale) * tracks[:, 3:4]
    noisy = np.fft.rfft(hiss[places] * window, _FFT) * _noise_filter(tracks) * tracks[:, 4:5]
    pieces = np.fft.irfft(voiced + noisy, _FFT)
    out = np.zeros(length + 2 * _FFT)
    for i, piece in enumerate(pieces):
        out[i * _HOP : i * _HOP + _FFT] += piece
    return out[2 * _HOP : 2 * _HOP + length]  # frames are centred on their time


def _vowel_filter(formants: Array) -> Array:
    """Complex response (t, bins) of the glottal slope and six resonances."""
    hertz = np.fft.rfftfreq(_FFT, 1 / SAMPLE_RATE_HZ)
    z = np.exp(-2j * np.pi * hertz / SAMPLE_RATE_HZ)[None, :]
    response = np.asarray(1 / (1 + (hertz / 500) ** 2) ** 0.5 * (hertz / (hertz + 60)), complex)[None, :]
    fixed = [np.full(len(formants), value) for value in (3500.0, 4500.0, 5700.0)]
    for centre, width in zip([*formants.T, *fixed], (70, 90, 130, 250, 350, 700), strict=True):
        radius = np.exp(-np.pi * width / SAMPLE_RATE_HZ)
        turn = 2 * np.pi * centre[:, None] / SAMPLE_RATE_HZ
        norm = 1 - 2 * radius * np.cos(turn) + radius**2  # unit gain at zero, as in a cascade
        response = response * norm / (1 - 2 * radius * np.cos(turn) * z + radius**2 * z**2)
    return np.asarray(response)


def _noise_filter(tracks: Array) -> Array:
    hertz = np.fft.rfftfreq(_FFT, 1 / SAMPLE_RATE_HZ)[None, :]
    return np.asarray(np.exp(-0.5 * ((hertz - tracks[:, 5:6]) / tracks[:, 6:7]) ** 2))
