"""The rates that the studio grants; addresses are never written to disk."""

from dataclasses import dataclass

from echoavatar.wire.rates import Rate


@dataclass(frozen=True)
class Rates:
    """The limits of an address, a session or an account."""

    login: Rate = Rate(8, 6)  # per address
    join: Rate = Rate(60, 60)  # per address: a whole classroom may join through one router
    answer: Rate = Rate(30, 60)  # per rater
    read: Rate = Rate(400, 1200)  # per session, clips and sounds included
    stranger: Rate = Rate(120, 240)  # per address, for requests without a session
    account: Rate = Rate(100, 60)  # sign-ins to one account from addresses that never succeeded
