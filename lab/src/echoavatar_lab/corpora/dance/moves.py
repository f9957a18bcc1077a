"""The dance moves of arms, torso and head: 2, 4 or 8 counts long, with named poses that arrive on counts.

Not from the paper, whose dance is recorded.
"""

from typing import Any

from .poses import Move, parse_keys

GROOVY = ("house", "hip_hop", "drum_and_bass", "rock", "swing", "salsa", "pop")
FLOWING = ("ballet", "ballad", "waltz", "rest")


def _move(name: str, counts: int, notation: str, **fields: Any) -> Move:
    return Move(name, counts, parse_keys(notation), **fields)


MOVES: tuple[Move, ...] = (
    _move(
        "arm_swing",
        2,
        "0 back/fore c:.1/.03/0; 1 fore/back c:-.1/.03/0",
        energy=(0.0, 0.8),
        styles=GROOVY,
        travel=1.0,
        flow=0.5,
    ),
    _move(
        "loose_bounce",
        4,
        "0 loose c:.06/.05/.04; 1 guard; 2 loose c:-.06/.05/-.04; 3 guard",
        energy=(0.0, 0.5),
        styles=GROOVY,
        flow=0.4,
    ),
    _move(
        "chest_pop",
        4,
        "0 loose c:0/-.2/0 h:0/.06/0; .5 guard c:0/.12/0; 1 loose c:0/-.2/0 h:0/.06/0; "
        "1.5 guard c:0/.12/0; 2 shrug c:.12/-.2/0 h:.2/0/0; 3 unshrug c:-.12/.1/0 h:-.2/.1/0",
        energy=(0.3, 1.0),
        styles=("hip_hop", "house", "drum_and_bass", "pop"),
        travel=0.42,
    ),
    _move(
        "body_roll",
        4,
        "0 side_low c:0/-.22/0 h:0/-.12/0; 1 loose c:0/-.02/0 h:0/.05/0; 2 hip c:0/.26/0 h:0/.18/0; 3 loose c:0/.05/0",
        energy=(0.2, 0.8),
        styles=("hip_hop", "house", "drum_and_bass", "salsa", "pop"),
        travel=1.0,
        flow=0.9,
    ),
    _move(
        "arm_wave",
        4,
        "0 wave_high/wave_low c:0/0/.1 h:.25/0/0; 1 wave_low/side; "
        "2 wave_low/wave_high c:0/0/-.1 h:-.25/0/0; 3 side/wave_low",
        energy=(0.3, 0.9),
        styles=("hip_hop", "house", "drum_and_bass", "ballet", "ballad", "pop"),
        travel=1.0,
        flow=0.8,
    ),
    _move(
        "raise",
        4,
        "0 chest c:0/.06/0; 1 vee c:0/-.1/0 h:0/-.12/0; 2 side c:0/-.04/0; 3 loose c:0/.08/0 h:0/.08/0",
        energy=(0.5, 1.0),
        styles=GROOVY,
        travel=0.85,
    ),
    _move(
        "clap",
        4,
        "0 unclap c:.1/0/.05; 1 clap c:.08/.08/.04 h:0/.08/0; 2 unclap c:-.1/0/-.05; 3 clap c:-.08/.08/-.04 h:0/.08/0",
        energy=(0.3, 1.0),
        styles=("house", "rock", "swing", "salsa", "pop", "hip_hop"),
        travel=0.6,
        exact=True,
    ),
    _move(
        "high_clap",
        4,
        "0 unclap c:0/.06/0; 1 high_clap c:0/-.06/0 h:0/-.1/0; 2 unclap c:0/.06/0; 3 high_clap c:0/-.06/0 h:0/-.1/0",
        energy=(0.75, 1.0),
        styles=("house", "rock", "pop"),
        travel=0.75,
        exact=True,
    ),
    _move(
        "punches",
        4,
        "0 punch/chamber c:-.22/.05/0; 1 chamber/punch c:.22/.05/0; 2 punch/chamber c:-.22/.05/0; "
        "2.5 chamber; 3 chamber/punch c:.24/.08/0 h:0/.08/0",
        energy=(0.6, 1.0),
        styles=("hip_hop", "drum_and_bass", "rock"),
        travel=0.5,
    ),
    _move(
        "shimmy",
        4,
        "0 shrug/unshrug c:.09/-.04/0; .5 unshrug/shrug c:-.09/-.04/0; "
        "1 shrug/unshrug c:.09/-.02/0; 1.5 unshrug/shrug c:-.09/-.02/0; 2 shrug/unshrug c:.09/0/0; "
        "2.5 unshrug/shrug c:-.09/0/0; 3 shrug/unshrug c:.09/.02/0; 3.5 unshrug/shrug c:-.09/.02/0",
        energy=(0.4, 1.0),
        styles=("salsa", "house", "swing", "pop"),
        travel=0.5,
    ),
    _move(
        "hand_circles",
        2,
        "0 circle_top/circle_low c:.05/.03/0; .5 circle_front/circle_near; "
        "1 circle_low/circle_top c:-.05/.03/0; 1.5 circle_near/circle_front",
        energy=(0.4, 0.9),
        styles=("house", "swing", "rock", "pop", "salsa"),
        travel=0.5,
        flow=1.0,
        exact=True,
    ),
    _move(
        "reach",
        4,
        "0 vee/hip c:.14/0/-.12 h:.2/-.15/0; 1 chest c:0/.06/0; 2 hip/vee c:-.14/0/.12 h:-.2/-.15/0; 3 chest c:0/.06/0",
        energy=(0.5, 1.0),
        styles=GROOVY,
    ),
    _move(
        "cross_uncross",
        4,
        "0 side c:0/-.08/0; 1 across/across_low c:0/.12/0 h:0/.1/0; 2 side c:0/-.08/0; "
        "3 across_low/across c:0/.12/0 h:0/.1/0",
        energy=(0.5, 1.0),
        styles=("house", "hip_hop", "rock", "drum_and_bass", "pop"),
        travel=0.75,
    ),
    _move(
        "side_snap",
        4,
        "0 snap_in c:0/.05/0; 1 snap/snap_in c:.14/-.02/-.05 h:.25/0/.08; 2 snap_in c:0/.05/0; "
        "3 snap_in/snap c:-.14/-.02/.05 h:-.25/0/-.08",
        energy=(0.15, 0.7),
        styles=("swing", "salsa", "rock", "pop", "house", "ballad"),
        travel=0.6,
    ),
    _move(
        "salsa_elbows",
        2,
        "0 salsa_back/salsa_front c:.14/.02/.05; 1 salsa_front/salsa_back c:-.14/.02/-.05",
        energy=(0.1, 1.0),
        styles=("salsa", "swing"),
        travel=0.9,
        flow=0.3,
    ),
    _move(
        "roof",
        2,
        "0 up_bent c:0/.08/0 h:0/.08/0; .5 vee c:0/-.06/0; 1 up_bent c:0/.08/0 h:0/.08/0; 1.5 vee c:0/-.06/0",
        energy=(0.8, 1.0),
        styles=("house", "hip_hop", "drum_and_bass", "pop"),
        travel=0.5,
        flow=0.2,
    ),
    _move(
        "disco",
        4,
        "0 point_up/hip c:.16/-.05/-.08 h:.2/-.1/0; 1 point_down/hip c:-.18/.12/.05 h:-.1/.15/0; "
        "2 point_up/hip c:.16/-.05/-.08 h:.2/-.1/0; 3 point_down/hip c:-.18/.12/.05 h:-.1/.15/0",
        energy=(0.55, 1.0),
        styles=("house", "pop", "rock"),
    ),
    _move(
        "overhead_sway",
        4,
        "0 sway_out/sway_in c:0/0/-.12 h:0/0/-.1; 2 sway_in/sway_out c:0/0/.12 h:0/0/.1",
        energy=(0.5, 1.0),
        styles=("house", "rock", "pop", "drum_and_bass"),
        travel=1.8,
        flow=0.5,
    ),
    _move(
        "push",
        4,
        "0 push/pull c:-.14/.05/0; 1 pull/push c:.14/.05/0; 2 push c:0/.1/0 h:0/.05/0; 3 pull c:0/-.08/0",
        energy=(0.4, 0.9),
        styles=("hip_hop", "drum_and_bass", "rock", "swing"),
        travel=0.6,
    ),
    _move(
        "frame",
        4,
        "0 frame_left/frame_right c:.08/-.03/.07 h:.15/-.03/.05; "
        "2 frame_left/frame_right c:-.08/-.03/-.07 h:.15/-.03/-.05",
        styles=("waltz",),
        travel=2.0,
        flow=0.8,
        is_fixed=True,
    ),
    _move(
        "open_arms",
        4,
        "0 first c:0/.06/0 h:0/.08/0; 1 second c:0/-.06/0 h:0/-.06/0; 2 second c:.1/-.05/-.08 h:.2/0/0; 3 demi",
        energy=(0.3, 1.0),
        styles=("waltz", "ballet", "ballad"),
        travel=1.4,
        flow=1.0,
    ),
    _move(
        "port_de_bras",
        8,
        "0 bras_bas c:0/.08/0 h:0/.12/0; 2 first h:.1/.05/0; "
        "4 fifth/second c:.1/-.1/-.1 h:-.25/-.12/.05; 6 second c:0/-.05/0 h:.2/-.05/0; "
        "7 demi c:0/.02/0 h:0/.05/0",
        energy=(0.2, 1.0),
        styles=("ballet",),
        travel=2.0,
        flow=1.0,
    ),
    _move(
        "arabesque_arms",
        8,
        "0 first/bras_bas c:.05/.04/0 h:.1/.05/0; 2 reach/second c:-.12/-.02/.06 h:.1/-.06/0; "
        "4 second/first c:.12/0/-.05 h:.2/0/0; 6 second/reach c:.12/-.02/-.06 h:-.1/-.06/0; "
        "7.5 demi",
        styles=("ballet",),
        travel=2.0,
        flow=1.0,
    ),
    _move(
        "soft_sway",
        8,
        "0 demi/bras_bas c:.06/.03/.06 h:.08/.04/.04; 1 demi c:.03/.02/.03; "
        "4 bras_bas/demi c:-.06/.03/-.06 h:-.08/.04/-.04; 6 bras_bas c:-.03/.03/0",
        energy=(0.0, 0.5),
        styles=FLOWING,
        travel=2.5,
        flow=1.0,
    ),
    _move(
        "hips",
        4,
        "0 hip c:0/0/.08 h:.1/.05/0; 1 hip c:0/.02/-.08 h:-.1/.05/0; 2 hip c:0/0/.08 h:.1/.05/0; "
        "3 hip c:0/.02/-.08 h:-.1/.05/0",
        energy=(0.1, 0.6),
        styles=("salsa", "rock", "pop", "hip_hop"),
        exact=True,
    ),
)
MOVE = {move.name: move for move in MOVES}


def fitting(style: str, energy: float) -> list[Move]:
    """The moves that fit a style and an energy; never empty."""
    kind = [move for move in MOVES if not move.styles or style in move.styles]
    near = [move for move in kind if move.energy[0] <= energy <= move.energy[1]]
    return near or [min(kind, key=lambda move: abs(energy - (move.energy[0] + move.energy[1]) / 2))]
