"""Sizes of a generator: vocabulary, order of the sequence, layers, and sampling defaults."""

from typing import Literal, Self

from pydantic import Field, model_validator

from echoavatar.config import Config
from echoavatar.timing import AUDIO_FRAMES_PER_CHUNK, MOTION_TOKENS_PER_CHUNK, exact_div

from ..tokens import ORDERS, SequenceOrder, TokenLayout

Precision = Literal["float32", "bfloat16", "int8"]  # of weights, see the lab's `linear`
AUDIO_FRAMES_PER_TOKEN = exact_div(AUDIO_FRAMES_PER_CHUNK, MOTION_TOKENS_PER_CHUNK)  # 10


class Opening(Config):
    """Codes that fill the window before anything was heard, so that a session starts at once."""

    silence: tuple[int, ...] = Field(description="codes of an audio frame of silence, one per layer")
    motion: int = Field(ge=0, description="code of every segment in the motion before the first")


class GeneratorConfig(Config):
    """The default is the small streaming model; `qwen_half_billion` is the paper's."""

    layout: TokenLayout = Field(default=TokenLayout(), description="rows of the vocabulary")
    sequence: Literal["interleaved", "prefix", "depth"] = Field(
        default="interleaved",
        description="order of audio and motion ids; depth: a frame at a time, with a second transformer for its codes",
    )
    window_chunks: int = Field(
        default=15, gt=0, le=512, description="chunks a position sees; 15 chunks are the paper's 4 s"
    )
    ahead_chunks: int = Field(
        default=0,
        ge=0,
        le=64,
        description="chunks of sound after its own that a chunk hears; above 0 offline only, as an upper bound",
    )
    width: int = Field(default=256, gt=0, description="channels of the residual stream")
    layers: int = Field(default=6, gt=0, le=256, description="transformer layers")
    heads: int = Field(default=4, gt=0, description="query heads")
    kv_heads: int = Field(default=2, gt=0, description="key and value heads")
    mlp: int = Field(default=768, gt=0, description="channels inside the SwiGLU block")
    depth_width: int = Field(default=384, gt=0, description="depth order: channels of the transformer over codes")
    depth_layers: int = Field(default=4, gt=0, description="depth order: its layers")
    depth_heads: int = Field(default=6, gt=0, description="depth order: its heads")
    rope_theta: float = Field(
        default=1e4, gt=0, description="rotary base; Qwen2.5 has 1e6, a short window from scratch less"
    )
    norm_eps: float = Field(default=1e-6, gt=0, description="epsilon of the RMS norms")
    temperature: float = Field(
        default=1.0, ge=0, description="default sampling temperature; 0 takes the likeliest code"
    )
    cooling: float = Field(
        default=1.0, gt=0, le=1, description="temperature of an RVQ layer over that of the layer before"
    )
    top_p: float = Field(default=0.95, gt=0, le=1, description="default nucleus mass")

    patience: float = Field(
        default=0.0, ge=0, description="cost of a change of code in its training data, over the mean error"
    )
    is_leveled: bool = Field(
        default=True, description="whether the sound of its training data has one loudness (paper: no)"
    )
    exemplar: bool = Field(
        default=False, description="whether a set of first-layer upper-body codes steers it (paper, stage 3)"
    )
    manner: bool = Field(
        default=False, description="depth order: whether it gets the manner of a speaker (not in the paper)"
    )
    control: Literal["gate", "prompt"] = Field(
        default="gate",
        description="how the set enters: by a vector and a gate (ours), or as control tokens in front of the window"
        " (paper; prefix order)",
    )

    step: int = Field(
        default=MOTION_TOKENS_PER_CHUNK,
        gt=0,
        le=64,
        description="motion tokens of a step: 2 (paper, 0.27 s); 1 in the depth order too, others (release: 3) in the"
        " prefix order only",
    )
    opening: Opening | None = Field(
        default=None, description="prefix order: codes that fill the window before a session; None: a window that grows"
    )
    steered: tuple[int, ...] = Field(
        default=(), description="segments whose codes a directive may name; (): the upper body's first layer"
    )
    example_bias: float | None = Field(
        default=None, description="nats that a directive adds to the logits of its codes; None: the pipeline's"
    )

    @model_validator(mode="after")
    def _fits_its_order(self) -> Self:
        if self.sequence != "prefix" and self.opening:
            raise ValueError("an opening belongs to the prefix order")
        steps = {"interleaved": (MOTION_TOKENS_PER_CHUNK,), "depth": (1, MOTION_TOKENS_PER_CHUNK)}
        if self.sequence != "prefix" and self.step not in steps[self.sequence]:
            raise ValueError(f"a step of {self.step} motion tokens belongs to the prefix order")
        if self.window_tokens % self.step:
            raise ValueError(f"the window ({self.window_tokens} motion tokens) must be whole steps of {self.step}")
        if self.ahead_chunks >= self.window_chunks:
            raise ValueError(
                f"ahead_chunks ({self.ahead_chunks}) must be under window_chunks ({self.window_chunks}),"
                " or no position hears the sound that is due"
            )
        if self.opening is not None and len(self.opening.silence) != self.layout.audio_layers:
            raise ValueError(f"silence needs a code for each of {self.layout.audio_layers} layers")
        if any(not 0 <= segment < self.layout.segments for segment in self.steered):
            raise ValueError(f"steered segments {self.steered} must lie in 0..{self.layout.segments - 1}")
        if self.exemplar and self.layout.parts == 1:
            raise ValueError("exemplars name codes of the upper body, and this body has no parts")
        if self.control == "prompt" and self.sequence != "prefix":
            raise ValueError("control tokens stand in front of a prompt, so they belong to the prefix order")
        if self.manner and self.sequence != "depth":
            raise ValueError("a manner steers generators of the depth order only")
        if self.steered and (self.exemplar or self.manner):
            raise ValueError("exemplars and manners steer a generator in the upper body's first layer only")
        return self

    @property
    def window_tokens(self) -> int:
        """Motion tokens in the window."""
        return self.window_chunks * MOTION_TOKENS_PER_CHUNK

    @property
    def audio_frames(self) -> int:
        """Audio frames of a step."""
        return self.step * AUDIO_FRAMES_PER_TOKEN

    @property
    def directed(self) -> tuple[int, ...]:
        """The segments whose codes a directive may name; it has K numbers for each."""
        return self.steered or (min(1, self.layout.parts - 1) * self.layout.motion_layers,)

    @model_validator(mode="after")
    def _heads_divide(self) -> Self:
        if self.width % (2 * self.heads):
            raise ValueError(f"width ({self.width}) must be an even multiple of heads ({self.heads})")
        if self.heads % self.kv_heads:
            raise ValueError(f"heads ({self.heads}) must be a multiple of kv_heads ({self.kv_heads})")
        if self.sequence == "depth" and self.depth_width % (2 * self.depth_heads):
            raise ValueError(
                f"depth_width ({self.depth_width}) must be an even multiple of depth_heads ({self.depth_heads})"
            )
        return self

    @property
    def head_width(self) -> int:
        """Channels of one head."""
        return self.width // self.heads

    @property
    def read_width(self) -> int:
        """Channels of the hidden states from which the output heads predict codes."""
        return self.depth_width if self.sequence == "depth" else self.width

    @property
    def depth(self) -> Self:
        """Sizes of the transformer over the codes of a frame, as a config of its own."""
        sizes = {"width": self.depth_width, "layers": self.depth_layers, "mlp": 3 * self.depth_width}
        heads = {"heads": self.depth_heads, "kv_heads": self.depth_heads, "rope_theta": 1e4}
        return self.model_copy(update=sizes | heads)

    @property
    def order(self) -> SequenceOrder:
        """The sequence order this generator was trained for."""
        return ORDERS[self.sequence](self.layout, self.window_chunks)


def qwen_half_billion(
    layout: TokenLayout, sequence: Literal["interleaved", "prefix", "depth"] = "prefix"
) -> GeneratorConfig:
    """Qwen2.5-0.5B's body over our vocabulary (paper, Settings)."""
    return GeneratorConfig(
        layout=layout,
        sequence=sequence,
        width=896,
        layers=24,
        heads=14,
        kv_heads=2,
        mlp=4864,
        rope_theta=1e6,
        top_p=1.0,
    )
