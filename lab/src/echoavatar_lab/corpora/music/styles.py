"""Musical styles as data: tempo, metre, drum rows, bass and chord rhythms, instruments.

Rows are strings over one bar of sixteenths (12 for 3/4 and 6/8): x plays, o plays softly, - rests.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class Style:
    """One style of music; `steps_per_beat` is the number of sixteenths in a beat."""

    name: str
    bpm: tuple[float, float]
    beats_per_bar: int = 4
    steps_per_beat: int = 4
    swing: float = 0.0
    drums: tuple[tuple[str, str], ...] = ()
    bass: str = ""
    chords: str = ""
    leads: tuple[str, ...] = ()
    comps: tuple[str, ...] = ()
    basses: tuple[str, ...] = ("finger_bass",)
    melody_density: float = 0.55

    @property
    def steps(self) -> int:
        """Sixteenths in a bar."""
        return self.beats_per_bar * self.steps_per_beat


_LEADS = ("flute", "saw_lead", "square_lead", "trumpet", "violin", "voice_aah", "voice_ooh", "clarinet", "bell")

STYLES: dict[str, Style] = {
    style.name: style
    for style in (
        Style(
            "house",
            (118, 130),
            drums=(
                ("kick", "x---x---x---x---"),
                ("clap", "----x-------x---"),
                ("open_hat", "--x---x---x---x-"),
                ("ride", "x---x---x---x---"),
                ("shaker", "oooooooooooooooo"),
            ),
            bass="--x---x---x---xx",
            chords="--x--x----x--x--",
            leads=("saw_lead", "square_lead", "voice_aah", "bell"),
            comps=("piano", "organ", "pad", "epiano"),
            basses=("synth_bass", "sub_bass"),
        ),
        Style(
            "hip_hop",
            (82, 98),
            swing=0.16,
            drums=(("kick", "x------x--x-----"), ("snare", "----x-------x---"), ("hat", "x-o-x-o-x-o-x-oo")),
            bass="x------x--x-----",
            chords="x-------x-----x-",
            leads=("voice_ooh", "flute", "square_lead", "trumpet", "bell"),
            comps=("epiano", "piano", "pad", "strings"),
            basses=("sub_bass", "finger_bass"),
        ),
        Style(
            "drum_and_bass",
            (165, 176),
            drums=(
                ("kick", "x---------x-----"),
                ("snare", "----x-------x---"),
                ("hat", "x-x-x-x-x-x-x-x-"),
                ("ride", "x---x---x---x---"),
            ),
            bass="x-----x---x-----",
            chords="x---------------",
            leads=("saw_lead", "voice_aah", "bell", "square_lead"),
            comps=("pad", "strings", "epiano"),
            basses=("synth_bass", "sub_bass"),
        ),
        Style(
            "waltz",
            (130, 180),
            beats_per_bar=3,
            drums=(("ride", "x---x---x---"), ("kick", "x-----------"), ("brush", "----o---o---")),
            bass="x-----------",
            chords="----x---x---",
            leads=("violin", "flute", "clarinet", "voice_aah", "accordion"),
            comps=("piano", "strings", "accordion", "guitar"),
        ),
        Style(
            "salsa",
            (160, 200),
            drums=(
                ("bell_bar", "x---x---x---x---"),
                ("clave", "x-----x---x-----"),
                ("conga", "--o-x---o---x-x-"),
                ("shaker", "x-o-x-o-x-o-x-o-"),
            ),
            bass="------x-----x---",
            chords="x-x--x-x-x--x-x-",
            leads=("trumpet", "flute", "voice_aah", "clarinet"),
            comps=("piano", "guitar", "organ"),
        ),
        Style(
            "rock",
            (104, 150),
            drums=(
                ("kick", "x-----x-x-------"),
                ("snare", "----x-------x---"),
                ("hat", "x-x-x-x-x-x-x-x-"),
                ("ride", "x---x---x---x---"),
            ),
            bass="x-x-x-x-x-x-x-x-",
            chords="x---x-x---x-x---",
            leads=("saw_lead", "voice_aah", "guitar_lead", "organ"),
            comps=("guitar", "organ", "piano", "fuzz"),
        ),
        Style(
            "swing",
            (120, 190),
            swing=0.33,
            drums=(("ride", "x---x-o-x---x-o-"), ("hat", "----x-------x---"), ("brush", "o---o---o---o---")),
            bass="x---x---x---x---",
            chords="x-----x---------",
            leads=("trumpet", "clarinet", "violin", "voice_ooh"),
            comps=("piano", "guitar", "organ"),
        ),
        Style(
            "ballet",
            (50, 66),
            beats_per_bar=2,
            steps_per_beat=6,
            bass="x-----x-----",
            chords="x-o-o-x-o-o-",
            leads=("violin", "flute", "clarinet", "voice_aah", "bell"),
            comps=("strings", "harp", "piano"),
            basses=("cello",),
        ),
        Style(
            "ballad",
            (62, 88),
            drums=(("kick", "x-------x-------"), ("snare", "----o-------o---"), ("hat", "o---o---o---o---")),
            bass="x-------x---x---",
            chords="x-o-o-o-x-o-o-o-",
            leads=("voice_aah", "voice_ooh", "violin", "flute"),
            comps=("piano", "epiano", "guitar", "harp"),
            melody_density=0.75,
        ),
        Style(
            "march",
            (100, 124),
            drums=(("kick", "x-------x-------"), ("snare", "x-ooxoo-x-ooxoxo"), ("crash", "x---------------")),
            bass="x---x---x---x---",
            chords="--x---x---x---x-",
            leads=("trumpet", "flute", "clarinet"),
            comps=("brass", "organ", "strings"),
            basses=("tuba",),
        ),
        Style(
            "solo",
            (66, 132),
            chords="x---o---x---o---",
            bass="x-------x-------",
            leads=_LEADS,
            comps=("piano", "guitar", "harp", "accordion", "organ", "strings"),
            melody_density=0.8,
        ),
    )
}
