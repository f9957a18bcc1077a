"""The paper's settings: the one place that recipes, tables and rewards take them from.

`lab/recipes/paper`, `reproduce --scale paper`, `align --recipe paper` and `align reward-... --paper` read them here. A
comment tells the place in the paper, or "ours" where the paper gives no value. `lab/tests/recipes/paper_fields.csv` has
every field of what is built from them, with its place.
"""

from typing import Any

from echoavatar.models.generator import qwen_half_billion
from echoavatar.models.tokens import TokenLayout

Sections = dict[str, dict[str, Any]]

CODEC: Sections = {  # Settings: EnCodec as released, which the paper does not train; these are its sizes
    "model": {"filters": 32, "width": 128, "codes": 1024, "residual_blocks": 1, "has_conv_shortcut": True},
    "training": {  # ours: another codec of these sizes
        "minutes": 0,  # steps alone end it
        "steps": 300_000,
        "batch": 64,
        "decoded": 32,
        "learning_rate": 3e-4,
        "warmup": 1000,
        "unquantized": 1000,
        "save_every": 0,
        "save_minutes": 10,
    },
}

TOKENIZER: Sections = {
    "model": {
        "width": 512,  # Settings: d
        "codes": 512,  # Settings: K
        "layers": 6,  # Settings: Q
        "blocks": "attention",  # Motion Tokenizer
        "resampling": "dual",  # Motion Tokenizer, figure B and C
        "lookback": 15,  # the release's, like the following
        "heads": 8,
        "decay": 0.99,
        "dead_below": 1.0,
        "kmeans_steps": 0,
    },
    "training": {
        "batch": 256,  # Settings
        "frames": 64,  # Settings
        "learning_rate": 4e-4,  # Settings
        "schedule": "step",  # Settings
        "decay_at": (0.5, 0.8),  # ours, like all up to save_minutes but temperature and dropout, the release's
        "decay_factor": 0.1,
        "steps": 100_000,
        "warmup": 200,
        "temperature": 0.5,
        "dropout": 0.2,
        "save_minutes": 10,
        "quantize_from": 0,  # departures, off
        "is_principal_start": False,
        "is_scaled_by_reach": False,
        "is_mirrored": False,  # the paper tells of mirrored motion for the alignment reward alone
        "losses": {  # appendix, Training Objective; Settings gives the commitment as 0.1
            "commitment": 0.5,
            "position": 0.02,
            "velocity": 0.2,
            "acceleration": 0.2,
            "foot_velocity": 0.3,
            "foot_position": 0.05,
            "travel": 0,  # departures, off
            "planted": 0,
            "fingers": 0,
            "root": 0,
            "turn": 0,
        },
    },
}

TOKENS: Sections = {  # Motion Tokenizer: each layer takes the nearest code; no level control, no mirrored motion
    "model": {},
    "training": {"patience": 0, "is_leveled": False, "is_mirrored": False},
}

_GENERATOR = qwen_half_billion(TokenLayout()).model_dump(exclude={"layout", "patience", "is_leveled"}) | {
    "window_chunks": 15  # Settings: 4 s, 600 audio and 540 motion ids
}
_FINE_TUNING: dict[str, Any] = {
    "batch": 256,  # Settings
    "learning_rate": 5e-5,  # Settings
    "accumulation": 4,  # ours, like all up to save_every
    "schedule": "cosine",
    "final_rate": 0.1,
    "weight_decay": 0.01,
    "autocast": True,
    "save_every": 1000,
    "optimiser": "adamw",
    "depth_weights": tuple(0.7**layer for layer in range(6)),  # Hierarchical Loss Scaling: they decay, values not given
    "corruption": "hierarchical",  # Hierarchical Token Corruption, rate not given
    "corruption_low": 0,
    "corruption_high": 0.5,
    "blind": 0,  # departures, off
    "out_of_step": 0,
    "other_past": 0,
    "cue_weight": 0,
    "short_windows": 0,
    "asked": 1,
    "exemplar": 0,
}
STAGE_1: Sections = {  # Embedding Space Alignment, after MECo: the body is frozen; 2e-4 is MECo's, the rest ours
    "model": _GENERATOR,
    "training": _FINE_TUNING
    | {
        "objective": "streams",
        "learning_rate": 2e-4,
        "corruption": "none",
        "steps": 5000,
        "accumulation": 2,
        "schedule": "constant",
        "warmup": 200,
        "weight_decay": 0,
        "save_every": 500,
    },
}
STAGE_2: Sections = {  # Acoustic-Kinematic Alignment; steps and warm-up are ours
    "model": _GENERATOR,
    "training": _FINE_TUNING | {"steps": 40_000, "warmup": 500},
}
STAGE_3: Sections = {  # Exemplar-Driven Control; one window in ten is told no set, so that the model moves by itself
    "model": _GENERATOR | {"exemplar": True, "control": "prompt", "example_bias": 0.0},
    "training": _FINE_TUNING | {"steps": 10_000, "warmup": 200, "exemplar": 0.9},
}

FACE: Sections = {  # appendix, Face Animation Generator
    "model": {
        "width": 256,
        "layers": 4,
        "heads": 8,
        "context": 56,
        "step": 8,
        "sampling_steps": 3,
        "guidance": 2,
        "head_blocks": 3,
        "head_width": 256,  # the release's, like the following
        "condition": 52,
        "head_split": True,
        "memory": "window",
        "noise_hold": 1,  # departures, off
        "late": 0,
    },
    "training": {
        "steps": 300_000,
        "batch": 128,
        "frames": 64,
        "learning_rate": 2e-4,
        "audio_dropout": 0.1,
        "tempo": True,
        "schedule": "constant",  # ours, like the following two
        "warmup": 0,
        "save_every": 5000,
        "history_noise": 0,  # departures, off
        "history_dropout": 0,
        "gain_db": 0,
        "high_noise": 1,
        "lips": 0,
        "listen": 0,
        "readout": 0,
        "draws": 1,
    },
}

QUALITY: Sections = {  # appendix, Motion Quality Reward Model Details: "mirrors our motion tokenizer"
    "model": {"width": 512, "heads": 8, "blocks": 1, "resampling": "dual", "differences": False},
    "training": {"steps": 20_000},  # ours, like all that is not here
}
ALIGNMENT: Sections = {  # appendix, Audio-Motion Alignment Reward Details
    "model": {"width": 512, "layers": 4, "heads": 8, "size": 768, "slices": 1, "motion": "features"},
    "training": {"steps": 20_000, "learning_rate": 1e-4, "schedule": "cosine", "batch": 32},  # steps are ours
}

_RL: dict[str, Any] = {
    "batch": 16,  # Settings
    "learning_rate": 6e-5,  # Settings
    "credit": "sequence",  # Reward-Guided Optimization: one advantage for a continuation
    "kl_weight": 0.01,  # Settings
    "past": 0,  # windows of 4 s; how much of them is context the paper does not say
    "length": 15,
    "discount": 1.0,  # ours, like the following two
    "fewest_events": 0,
    "kl_stop": 1e6,  # never
}
RL: dict[str, dict[str, Any]] = {
    "grpo": _RL | {"group": 30, "accumulation": 16},  # Settings
    "dpo": _RL | {"group": 8, "beta": 0.1, "accumulation": 2},  # Direct Preference Alignment; Settings
    "ppo": _RL | {"group": 1, "critic_rate": 1e-5},  # appendix, Comparison with PPO
}
REWARDS = {"quality": 1.0, "alignment": 1.0}  # both, Reward-Guided Optimization; weights ours
SPEECH_HOURS, PIECES = 1.0, 100  # RL Alignment Corpus

RECIPES = {
    "codec": CODEC,
    "tokenizer": TOKENIZER,
    "tokens": TOKENS,
    "generator_stage1": STAGE_1,
    "generator_stage2": STAGE_2,
    "generator_stage3": STAGE_3,
    "face": FACE,
}
"""Settings of the stages of `echoavatar train`; a recipe takes them by `paper: NAME`."""
