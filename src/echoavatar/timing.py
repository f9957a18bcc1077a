"""The clock: every rate of the system, counted in samples at 24 kHz and derived once.

Uses nothing else of the package. Paper, Settings: 30 fps motion, 7.5 Hz motion tokens, EnCodec at 75 Hz,
steps of 8 frames (0.266 s).
"""

from dataclasses import dataclass


def exact_div(numerator: int, denominator: int) -> int:
    """The exact quotient. Raises ValueError: there is a remainder, which would be a mistake in the clock."""
    quotient, remainder = divmod(numerator, denominator)
    if remainder:
        raise ValueError(f"{numerator} is not a multiple of {denominator}")
    return quotient


SAMPLE_RATE_HZ = 24_000
FRAME_RATE_HZ = 30
AUDIO_TOKEN_RATE_HZ = 75

SAMPLES_PER_FRAME = exact_div(SAMPLE_RATE_HZ, FRAME_RATE_HZ)  # 800
SAMPLES_PER_AUDIO_TOKEN = exact_div(SAMPLE_RATE_HZ, AUDIO_TOKEN_RATE_HZ)  # 320
FRAMES_PER_MOTION_TOKEN = 4
SAMPLES_PER_MOTION_TOKEN = FRAMES_PER_MOTION_TOKEN * SAMPLES_PER_FRAME  # 3,200 samples, 7.5 Hz
CHUNK_FRAMES = 8
CHUNK_SAMPLES = CHUNK_FRAMES * SAMPLES_PER_FRAME  # 6,400: the sound that one step of the paper takes
CHUNK_SECONDS = CHUNK_SAMPLES / SAMPLE_RATE_HZ  # 0.2667
AUDIO_FRAMES_PER_CHUNK = exact_div(CHUNK_SAMPLES, SAMPLES_PER_AUDIO_TOKEN)  # 20, times two RVQ layers
MOTION_TOKENS_PER_CHUNK = exact_div(CHUNK_FRAMES, FRAMES_PER_MOTION_TOKEN)  # 2 time steps


@dataclass(frozen=True)
class ChunkSize:
    """What one step of a pipeline consumes and produces: two motion tokens, unless its bundle sets another number."""

    tokens: int = MOTION_TOKENS_PER_CHUNK

    @classmethod
    def of(cls, samples: int) -> "ChunkSize":
        """The size of a chunk with this many samples. Raises ValueError: they are no whole number of motion tokens."""
        if samples < 1:
            raise ValueError(f"a chunk has one sample or more, not {samples}")
        return cls(exact_div(samples, SAMPLES_PER_MOTION_TOKEN))

    @property
    def frames(self) -> int:
        """Frames of motion in a chunk, 30 a second."""
        return self.tokens * FRAMES_PER_MOTION_TOKEN

    @property
    def samples(self) -> int:
        """Samples of sound in a chunk, 24,000 a second."""
        return self.tokens * SAMPLES_PER_MOTION_TOKEN

    @property
    def seconds(self) -> float:
        """Length of a chunk, in seconds."""
        return self.samples / SAMPLE_RATE_HZ

    def within(self, seconds: float) -> int:
        """The number of chunks whose length is nearest to `seconds`, at least one."""
        return max(1, round(seconds / self.seconds))


CHUNK = ChunkSize()  # 8 frames, 6,400 samples: the paper's chunk, and the default of bundles
