"""The flite speech engine through ctypes: audio with exact phone times; pitch is edited before the vocoder.

flite (CMU, permissive licence) is an optional system package. It is not thread-safe. It stores feature names by
pointer, so `_key` keeps every name alive. Its excitation noise comes from
libc's rand(), which is seeded for each utterance.
"""

import ctypes
import ctypes.util
from collections.abc import Iterator
from dataclasses import replace
from functools import cache

import numpy as np
import soxr

from echoavatar.errors import DependencyError
from echoavatar.timing import SAMPLE_RATE_HZ

from ..sound import FloatArray
from .prosody import Delivery, SpokenSyllable, Utterance, lift_nuclei, score_prominence, shape_pitch
from .script import Word

VOICES = ("slt", "awb", "rms")
_LIBRARIES = ("flite", "flite_usenglish", "flite_cmulex", *(f"flite_cmu_us_{voice}" for voice in VOICES))
_MARGIN_S = 0.03
_DEFAULT_ALPHA = 0.42
_DB_BYTES = 320
_P, _S, _F, _I = ctypes.c_void_p, ctypes.c_char_p, ctypes.c_float, ctypes.c_int


class _Wave(ctypes.Structure):
    _fields_ = [
        ("type", _S),
        ("sample_rate", _I),
        ("num_samples", _I),
        ("num_channels", _I),
        ("samples", ctypes.POINTER(ctypes.c_short)),
    ]


class _Track(ctypes.Structure):
    _fields_ = [
        ("type", _S),
        ("num_frames", _I),
        ("num_channels", _I),
        ("times", ctypes.POINTER(_F)),
        ("frames", ctypes.POINTER(ctypes.POINTER(_F))),
    ]


class _Voice(ctypes.Structure):
    _fields_ = [("name", _S), ("features", _P)]


_SIGNATURES: dict[str, tuple[object, list[object]]] = {
    "flite_init": (_I, []),
    "new_utterance": (_P, []),
    "utt_init": (_P, [_P, _P]),
    "utt_relation_create": (_P, [_P, _S]),
    "utt_relation_present": (_I, [_P, _S]),
    "utt_relation": (_P, [_P, _S]),
    "relation_append": (_P, [_P, _P]),
    "relation_head": (_P, [_P]),
    "item_next": (_P, [_P]),
    "item_as": (_P, [_P, _S]),
    "item_daughter": (_P, [_P]),
    "item_set_string": (None, [_P, _S, _S]),
    "item_set_float": (None, [_P, _S, _F]),
    "utt_synth_tokens": (_P, [_P]),
    "ffeature_string": (_S, [_P, _S]),
    "ffeature_float": (_F, [_P, _S]),
    "feat_val": (_P, [_P, _S]),
    "val_track": (ctypes.POINTER(_Track), [_P]),
    "val_cg_db": (_P, [_P]),
    "mlpg": (ctypes.POINTER(_Track), [ctypes.POINTER(_Track), _P]),
    "mlsa_resynthesis": (
        ctypes.POINTER(_Wave),
        [ctypes.POINTER(_Track), ctypes.POINTER(_Track), _P, ctypes.POINTER(_Track), _I],
    ),
    "delete_wave": (None, [ctypes.POINTER(_Wave)]),
    "delete_track": (None, [ctypes.POINTER(_Track)]),
    "delete_utterance": (None, [_P]),
    "flite_feat_set_float": (None, [_P, _S, _F]),
}


@cache
def _key(text: str) -> bytes:
    """The bytes of a text, cached for ever: flite stores feature names by address, so they must never be freed."""
    return text.encode()


class Flite:
    """The loaded library with its voices; `flite()` returns the one instance of the process."""

    def __init__(self) -> None:
        loaded: dict[str, ctypes.CDLL] = {}
        for name in _LIBRARIES:
            path = ctypes.util.find_library(name)
            if path is None:
                raise DependencyError(
                    f"the flite speech engine is not installed: lib{name} was not found; "
                    'run "apt install flite libflite1", or ask for engine="own"'
                )
            loaded[name] = ctypes.CDLL(path, mode=ctypes.RTLD_GLOBAL)
        self.lib = loaded["flite"]
        for function, (result, arguments) in _SIGNATURES.items():
            entry = getattr(self.lib, function)
            entry.restype, entry.argtypes = result, arguments
        self.lib.flite_init()
        self.voices: dict[str, int] = {}
        for name in VOICES:
            register = getattr(loaded[f"flite_cmu_us_{name}"], f"register_cmu_us_{name}")
            register.restype, register.argtypes = _P, [_S]
            self.voices[name] = register(None)
        self._libc = ctypes.CDLL(None)
        self._databases: dict[tuple[int, float], ctypes.Array[ctypes.c_char]] = {}

    def say(self, words: tuple[Word, ...], delivery: Delivery, seed: int) -> Utterance:
        """Speak the words in one breath; the same seed gives the same samples."""
        voice = self.voices[delivery.voice]
        features = ctypes.cast(voice, ctypes.POINTER(_Voice)).contents.features
        self.lib.flite_feat_set_float(features, _key("duration_stretch"), 1 / delivery.rate)
        self._libc.srand(seed & 0x7FFFFFFF)
        utterance = self._tokens(words, voice)
        try:
            self.lib.utt_synth_tokens(utterance)
            phones = self._phones(utterance)
            syllables = score_prominence(self._syllables(utterance), words)
            audio, rate_hz = self._vocode(utterance, syllables, delivery, words[-1].mark == "?", seed)
        finally:
            self.lib.delete_utterance(utterance)
        audio = lift_nuclei(audio, rate_hz, syllables, delivery.nucleus_db)
        return _trim(audio, rate_hz, phones, syllables)

    def _tokens(self, words: tuple[Word, ...], voice: int) -> int:
        utterance = int(self.lib.new_utterance())
        self.lib.utt_init(utterance, voice)
        relation = self.lib.utt_relation_create(utterance, _key("Token"))
        for i, word in enumerate(words):
            item = self.lib.relation_append(relation, None)
            values = {"name": word.text, "whitespace": " ", "prepunctuation": "", "punc": word.mark, "place": str(i)}
            for name, value in values.items():
                self.lib.item_set_string(item, _key(name), _key(value))
            if word.is_focus:
                self.lib.item_set_float(item, _key("local_duration_stretch"), 1.25)
        return utterance

    def _items(self, utterance: int, relation: str) -> Iterator[int]:
        if self.lib.utt_relation_present(utterance, _key(relation)):
            item = self.lib.relation_head(self.lib.utt_relation(utterance, _key(relation)))
            while item:
                yield item
                item = self.lib.item_next(item)

    def _text(self, item: int, path: str) -> str:
        return str(self.lib.ffeature_string(item, _key(path)).decode())

    def _phones(self, utterance: int) -> tuple[tuple[float, float, str], ...]:
        ends = [
            (float(self.lib.ffeature_float(i, _key("end"))), self._text(i, "name"))
            for i in self._items(utterance, "Segment")
        ]
        starts = [0.0] + [end for end, _ in ends[:-1]]
        return tuple((start, end, name) for start, (end, name) in zip(starts, ends, strict=True))

    def _syllables(self, utterance: int) -> tuple[SpokenSyllable, ...]:
        lib, found = self.lib, []
        for item in self._items(utterance, "Syllable"):
            part = lib.item_daughter(lib.item_as(item, _key("SylStructure")))
            start, end, vowel = float(lib.ffeature_float(part, _key("R:Segment.p.end"))), 0.0, None
            begin = start
            while part:
                end = float(lib.ffeature_float(part, _key("end")))
                if self._text(part, "ph_vc") == "+":
                    vowel = (begin + end) / 2
                begin, part = end, lib.item_next(part)
            found.append(
                SpokenSyllable(
                    start,
                    end,
                    vowel if vowel is not None else (start + end) / 2,
                    int(self._text(item, "R:SylStructure.parent.R:Token.parent.place")),
                    is_stressed=self._text(item, "stress") == "1",
                    has_accent=self._text(item, "accent") not in ("0", ""),
                )
            )
        return tuple(found)

    def _vocode(
        self, utterance: int, syllables: tuple[SpokenSyllable, ...], delivery: Delivery, is_question: bool, seed: int
    ) -> tuple[FloatArray, int]:
        """Run the vocoder again with the expressive pitch; return audio (s,) and its sample rate."""
        lib = self.lib
        features = ctypes.cast(utterance, ctypes.POINTER(_P)).contents.value
        database = lib.val_cg_db(lib.feat_val(features, _key("cg_db")))
        track = lib.val_track(lib.feat_val(features, _key("param_track")))
        strengths = lib.val_track(lib.feat_val(features, _key("str_track")))
        frames = track.contents.num_frames
        rows = track.contents.frames
        f0 = np.array([rows[i][0] for i in range(frames)], dtype=np.float32)
        shaped = shape_pitch(f0, frame_s=0.005, syllables=syllables, delivery=delivery, is_question=is_question)
        for i, value in enumerate(shaped.tolist()):
            rows[i][0] = value
        self._libc.srand(seed & 0x7FFFFFFF)
        smooth = lib.mlpg(track, database)
        wave = lib.mlsa_resynthesis(smooth, strengths, self._warped(database, delivery.alpha), None, 0)
        content = wave.contents
        integers = np.ctypeslib.as_array(content.samples, (content.num_samples,))
        samples = np.asarray(integers / 32768, dtype=np.float32)
        rate_hz = int(content.sample_rate)
        lib.delete_wave(wave)
        lib.delete_track(smooth)
        return samples, rate_hz

    def _warped(self, database: int, alpha: float) -> object:
        """Address of a copy of the voice's read-only database with another frequency warping."""
        if (database, alpha) not in self._databases:
            raw = bytearray(ctypes.string_at(database, _DB_BYTES))
            place = raw.find(np.float32(_DEFAULT_ALPHA).tobytes())
            if place >= 0:
                raw[place : place + 4] = np.float32(alpha).tobytes()
            self._databases.clear()
            self._databases[database, alpha] = ctypes.create_string_buffer(bytes(raw), len(raw))
        return ctypes.addressof(self._databases[database, alpha])


def _trim(
    audio: FloatArray, rate_hz: int, phones: tuple[tuple[float, float, str], ...], syllables: tuple[SpokenSyllable, ...]
) -> Utterance:
    """Cut outer silence down to a short margin and resample to 24 kHz without delay."""
    spoken = [phone for phone in phones if phone[2] != "pau"]
    first = max(0, round((spoken[0][0] - _MARGIN_S) * rate_hz))
    last = round((spoken[-1][1] + _MARGIN_S) * rate_hz)
    begin = first / rate_hz
    fade = np.minimum(1, np.arange(last - first) / (0.01 * rate_hz))
    kept = audio[first:last] * fade[: len(audio[first:last])] * fade[::-1][: len(audio[first:last])]
    return Utterance(
        soxr.resample(kept.astype(np.float32), rate_hz, SAMPLE_RATE_HZ, quality="HQ"),
        tuple((a - begin, b - begin, name) for a, b, name in phones if a >= spoken[0][0] and b <= spoken[-1][1]),
        tuple(replace(s, start=s.start - begin, end=s.end - begin, vowel=s.vowel - begin) for s in syllables),
    )


@cache
def flite() -> Flite:
    """The engine of this process; raises DependencyError if flite is not installed."""
    return Flite()
