"""Steps of a piece of work: each told with its number and its share of the whole."""

import pytest

from difffric.known_so_far import keep_known, tell_known
from difffric.progress import Steps, silent


def test_the_parts_of_a_step_share_what_the_step_is_of_the_whole():
    heard = []
    steps = Steps(lambda what, share: heard.append((what, share)), (0.2, 1.0))
    first = steps.begin("first")
    first("half", 0.5)
    second = steps.begin("second")
    second("all", 1.0)
    assert [what for what, _ in heard] == [
        "step 1 of 2: first",
        "step 1 of 2: first, half",
        "step 2 of 2: second",
        "step 2 of 2: second, all",
    ]
    assert [share for _, share in heard] == pytest.approx([0.0, 0.1, 0.2, 1.0])
    Steps(silent, (1.0,)).begin("heard by nobody")("neither", 0.5)


def test_what_is_told_again_replaces_what_was_known():
    tell_known("the fit", "told to nobody")
    with keep_known() as known:
        tell_known("the fit", "first")
        tell_known("a cause", "seen", ["stribeck"])
        tell_known("the fit", "better", {"k": 1.0})
    tell_known("the fit", "too late")
    assert {what: part.words for what, part in known.parts.items()} == {
        "the fit": "better",
        "a cause": "seen",
    }
    assert known.parts["the fit"].answer == {"k": 1.0}
