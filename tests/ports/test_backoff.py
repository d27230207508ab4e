from drd.ports.backoff import Backoff


def test_waits_double_from_a_tenth_of_a_second_to_two_seconds() -> None:
    backoff = Backoff()
    assert [backoff.next_s() for _ in range(7)] == [0.1, 0.2, 0.4, 0.8, 1.6, 2.0, 2.0]


def test_a_reset_starts_again_at_the_shortest_wait() -> None:
    backoff = Backoff()
    for _ in range(5):
        backoff.next_s()
    backoff.reset()
    assert backoff.next_s() == 0.1
