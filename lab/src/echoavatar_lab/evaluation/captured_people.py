"""How much captured people move and vary: mean, lowest and highest window of 30 s of each statistic.

The statistics are those of `metrics.liveliness`. Speech and music are the speakers and dancers that the project's bars
were set with. Silence and listening are 84 windows of the 22 takes of ReActIdle ((c) 2025 RSAIT, MIT).
"""

SPEECH, MUSIC, SILENCE, LISTENING = KINDS = ("speech", "music", "silence", "listening")

_STANDING = {
    "hand_speed": (0.09, 0.01, 0.39),
    "hands_still": (0.72, 0.07, 1.0),
    "hands_at_work": (0.02, 0.0, 0.25),
    "room": (15, 2, 76),
    "novelty": (0.02, 0.0, 0.09),
    "shoulder_turn": (2.3, 0.3, 8.7),
    "trunk_lean": (1.2, 0.2, 4.1),
    "hip_sway": (2.1, 0.1, 9.8),
    "ankle_speed": (0.01, 0.0, 0.14),
}
PEOPLE: dict[str, dict[str, tuple[float, float, float]]] = {
    SPEECH: {
        "hand_speed": (0.94, 0.57, 1.12),
        "hands_still": (0.04, 0.01, 0.10),
        "hands_at_work": (0.59, 0.33, 0.72),
        "room": (156, 116, 206),
        "novelty": (0.13, 0.11, 0.16),
        "shoulder_turn": (4.7, 2.7, 7.4),
        "trunk_lean": (4.4, 3.1, 5.6),
        "hip_sway": (8.4, 6.1, 10.0),
        "ankle_speed": (0.08, 0.01, 0.18),
    },
    MUSIC: {
        "hand_speed": (1.28, 0.31, 2.5),
        "hands_still": (0.01, 0.0, 0.03),
        "hands_at_work": (0.65, 0.19, 0.99),
        "room": (228, 34, 394),
        "novelty": (0.15, 0.04, 0.24),
        "shoulder_turn": (17.5, 12.4, 27.4),
        "trunk_lean": (11.3, 5.1, 24.5),
        "hip_sway": (41, 19, 63),
        "ankle_speed": (0.73, 0.52, 0.95),
    },
    SILENCE: _STANDING,
    LISTENING: _STANDING,
}
