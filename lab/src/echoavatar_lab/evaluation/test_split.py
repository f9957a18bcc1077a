"""The recordings of split "test" are heard once for each generator, whose card then says when and by what.

Settings and weights are chosen on "dev". Numbers of "test" that were read several times have chosen too.
"""

import json
from datetime import UTC, datetime
from pathlib import Path

from echoavatar.errors import EchoAvatarError
from echoavatar.stored import WEIGHTS, read_card
from echoavatar.whole_file import write_whole
from echoavatar_lab.data.corpus import checksum

READINGS = "test_readings"


def claim_test(generator: Path, *, command: str, commit: str, is_again: bool = False) -> None:
    """Write into the card of a generator's folder that the test recordings are heard now.

    Raises EchoAvatarError: these weights have heard them, and it is not said that they do so again.
    """
    card, weights = read_card(generator), checksum(generator / WEIGHTS)
    listed = card.get(READINGS)
    told = [one for one in listed if isinstance(one, dict)] if isinstance(listed, list) else []
    before = [one for one in told if one.get("weights") == weights]
    if before and not is_again:
        raise EchoAvatarError(
            f"{generator} has heard split test on {before[-1].get('date')} (commit {before[-1].get('commit')}): quote"
            " those numbers, measure on dev, or give --again, which its card will say"
        )
    reading: dict[str, object] = {"date": f"{datetime.now(UTC):%Y-%m-%d}", "commit": commit, "command": command}
    reading |= {"weights": weights} | ({"again": len(before)} if before else {})
    write_whole(generator / "card.json", json.dumps(card | {READINGS: [*told, reading]}, indent=2) + "\n")
