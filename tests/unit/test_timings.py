"""What is counted of a piece of work, and to whom it is told."""

from concurrent.futures import ThreadPoolExecutor

from difffric.estimation.following.thread_pool import map_in_threads
from difffric.timings import count_followed, keep_timings


def test_counts_go_to_the_part_that_is_going_on():
    with keep_timings() as timings:
        timings.begin("start 1 of 2")
        count_followed(1, (3, 4), (6, 32))
        timings.begin("settling")
        count_followed(2, (5, 5))
        timings.begin("start 2 of 2")
        count_followed(1, (1, 4), (2, 32))
    told = timings.as_dict()
    assert list(told) == ["start", "settling"]
    assert {**told["start"], "seconds": 0} == {
        "seconds": 0,
        "calls": 2,
        "pushes": 4,
        "pushes_computed": 8,
        "directions": 8,
        "directions_computed": 64,
    }
    assert told["settling"]["pushes"] == 5


def test_who_keeps_no_timings_hears_of_none():
    with keep_timings() as timings:
        timings.begin("mine")
        with ThreadPoolExecutor(1) as beside:  # another's work, in a context of its own
            beside.submit(count_followed, 1, (7, 7)).result()
    count_followed(1, (7, 7))
    assert timings.as_dict()["mine"]["calls"] == 0


def test_work_that_is_spread_over_threads_counts_as_ours():
    with keep_timings() as timings:
        timings.begin("mine")
        map_in_threads(lambda n: count_followed(1, (n, n)), range(100))
    assert timings.as_dict()["mine"]["pushes"] == sum(range(100))
