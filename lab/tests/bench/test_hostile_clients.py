"""What the neighbours send."""

from echoavatar_lab.bench.hostile_clients import CANDIDATES, Target, with_candidates


def test_an_offer_gets_its_candidates() -> None:
    target = Target("http://x", "", "", "", "v=0\r\na=candidate:1 1 udp 7 10.0.0.1 9 typ host\r\na=end\r\n")
    offer = with_candidates(target, lambda number: f"n{number}.local").offer
    assert offer.count("a=candidate:") == CANDIDATES + 1
    assert offer.endswith("a=end\r\n")
