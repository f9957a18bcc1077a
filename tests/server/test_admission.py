from echoavatar.server.admission import Admission


class Scope:
    cancel_called = False

    def cancel(self) -> None:
        self.cancel_called = True


def test_a_silent_connection_gives_way_and_one_that_said_hello_does_not() -> None:
    admission = Admission(2)
    first, second, third, fourth = (Scope() for _ in range(4))
    assert admission.enter(first, "a")
    assert admission.enter(second, "a")
    admission.greet(first)
    assert admission.enter(third, "b")
    assert (first.cancel_called, second.cancel_called) == (False, True)
    admission.greet(third)
    assert not admission.enter(fourth, "c")
    admission.leave(first)
    assert admission.enter(fourth, "c")
    assert len(admission) == 2


def test_the_address_with_the_most_silent_connections_gives_way() -> None:
    admission = Admission(3)
    alone, crowd = Scope(), [Scope() for _ in range(3)]
    admission.enter(alone, "alone")
    for scope in crowd:
        assert admission.enter(scope, "crowd")
    assert not alone.cancel_called
    assert [scope.cancel_called for scope in crowd] == [True, False, False]


def test_an_evicted_connection_cannot_keep_its_place_by_a_late_hello() -> None:
    admission = Admission(1)
    late, newcomer = Scope(), Scope()
    admission.enter(late, "a")
    admission.enter(newcomer, "b")
    admission.greet(late)
    admission.leave(late)
    assert len(admission) == 1


def test_one_address_does_not_take_all_places() -> None:
    admission = Admission(10, per_address=2)
    first, second, third, fourth = (Scope() for _ in range(4))
    assert admission.enter(first, "a")
    admission.greet(first)
    assert admission.enter(second, "a")
    assert admission.enter(third, "a")
    assert (first.cancel_called, second.cancel_called) == (False, True)  # its own silent one gives way
    admission.greet(third)
    assert not admission.enter(fourth, "a")
    assert admission.enter(fourth, "b")
    admission.leave(first)
    assert admission.enter(Scope(), "a")


def test_an_ipv6_network_is_one_address() -> None:
    admission = Admission(10, per_address=1)
    scope = Scope()
    assert admission.enter(scope, "2001:db8::1")
    admission.greet(scope)
    assert not admission.enter(Scope(), "2001:db8::2")
    assert admission.enter(Scope(), "2001:db8:0:1::2")
