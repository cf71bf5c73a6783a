"""The threads that follow pushes: compiled programs let others run beside them."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from contextvars import copy_context
from functools import cache
from typing import Any

from difffric.cores import count_cores


def map_in_threads(function: Callable[[Any], Any], items: Iterable[Any]) -> list[Any]:
    """`function` of each of the items, in their order, computed by as many threads as there are
    processors for this process. It must not call this function itself."""
    given = [(copy_context(), item) for item in items]
    return list(_start_threads().map(lambda one: one[0].run(function, one[1]), given))


@cache
def _start_threads() -> ThreadPoolExecutor:
    """The threads, started once: a search asks for some hundred batches of answers."""
    return ThreadPoolExecutor(count_cores(), thread_name_prefix="difffric-pushes")
