"""Who is heard in which split of the recordings that the default bundle is made with.

Their manifest marks "train" and "test", but its "test" has chosen weights and settings, and eight artists are in both.
So the voices of that "test" are DEV, whoever stood in two splits goes wholly to one, and TEST holds 12 voices and 12
tracks that were in "train", by speakers and artists who are nowhere else. Nothing is trained or chosen on TEST.
Wolfgang and Theodore Kerr (Wolfgang_) are one person, and uncredited tracks of FreePD may be Kevin MacLeod's. EmoDB has
no voice in TEST, because all of its speakers say the same ten sentences.
"""


def _names(text: str) -> frozenset[str]:
    return frozenset(" ".join(name.split()) for name in text.split(";"))


TEST = _names("""
    Cocotte; Frédéric Surget; Linda Johnson (f); LibriSpeech 1998 (F, Sonja); LibriSpeech 2033 (M, Filippo
    Gioachin); LibriSpeech 2414 (M, Ashwin Jain); LibriSpeech 2609 (M, Ian Hatley); LibriSpeech 3005 (M, Ken
    Tischler); LibriSpeech 3080 (F, breathe); LibriSpeech 3331 (F, Peggy); LibriSpeech 367 (F, Kathleen Dang);
    LibriSpeech 533 (F, Ana Simao); @emegeme; Alexander Nakarada; Brian Boyko; Dan Knoflicek; Florian Filsinger;
    HorrorPen; Komiku; Tarush Singhal; cynicmusic; rezoner
""")
DEV = _names("""
    EmoDB 03 (m31); LibriSpeech 1034 (M, Kevin O'Coin); LibriSpeech 1098 (F, Merryb); LibriSpeech 1737 (F, Erin
    Hastings); LibriSpeech 196 (M, Stewart Wills); LibriSpeech 1970 (F, Dawn Larsen); LibriSpeech 2007 (F,
    Sheila Morton); LibriSpeech 2092 (F, Elaine Hamby); LibriSpeech 211 (F, shanda_w); LibriSpeech 2289 (M,
    David Kleparek); LibriSpeech 248 (F, Becky Miller); LibriSpeech 2910 (F, Janna); LibriSpeech 2989 (F, Jamie
    Strassenburg, Cypress, California); LibriSpeech 3486 (M, Robin Balmer); LibriSpeech 3807 (M, Jesse Noar);
    LibriSpeech 3857 (M, Epistomolus); LibriSpeech 39 (F, Sherry Crowther); LibriSpeech 3947 (F, johnell);
    LibriSpeech 4014 (M, Tom Clifton); LibriSpeech 445 (M, Dave Foss); LibriSpeech 446 (M, Steve Hartzog);
    LibriSpeech 481 (M, Neal Foley); LibriSpeech 4830 (M, George Aalto); LibriSpeech 5163 (F, LilyAnne);
    LibriSpeech 5390 (M, Charles Bice); LibriSpeech 5688 (F, Jennifer Dionne); LibriSpeech 5703 (M, Garth
    Comira); LibriSpeech 5789 (F, Kirsten Wever); LibriSpeech 6064 (F, Deborah Knight); LibriSpeech 6078 (F,
    dobsonfly); LibriSpeech 6081 (M, Lazuli); LibriSpeech 6181 (M, Mike); LibriSpeech 6476 (F, Viridian);
    LibriSpeech 7067 (M, Matthew Wall); LibriSpeech 7402 (M, Canby Ibarra); LibriSpeech 7447 (M, dasbury);
    LibriSpeech 7780 (F, tazzle); LibriSpeech 7794 (F, mlcui); LibriSpeech 7859 (F, xinamarieuhl); LibriSpeech
    8465 (F, TinaNygard2); LibriSpeech 8629 (M, Shivansh Dhar); dmitri; faber; kathleen; pim; Bryan Teoh; Efface
    Studios; Jason Shaw; Theodore Kerr (Wolfgang_); Wolfgang; qubodup / yd
""")
TRAIN = _names("freesound / Sonic Pi; HoliznaCC0; Kevin MacLeod; PlayOnLoop.com; uncredited (FreePD)")
_SPLITS = {"test": TEST, "dev": DEV, "train": TRAIN}


def split_of(voice: str, listed: str) -> str:
    """The split of a speaker or artist: of a known one as above, of others as `listed` in their manifest."""
    return next((split for split, names in _SPLITS.items() if voice in names), listed)
