"""A progress bar on standard error for long work: rich's when it is installed, else a line now and then."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

__all__ = ["bar"]

# Without rich: seconds between two lines.
LINE_SECONDS = 5.0


@contextmanager
def bar(unit: str, total: int, *, show: bool = True) -> Iterator[Callable[[int], None]]:
    """Show how far work has come, its rate and the time that remains.

    Args:
        unit: What is counted, for example "steps".
        total: How many there are.
        show: False: count silently.

    Yields:
        A function that is told how many more are done.
    """
    if not show:
        yield lambda count: None
        return
    try:
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
    except ImportError:
        yield _lines(unit, total)
        return
    rate = TextColumn("{task.fields[rate]}")
    columns = (BarColumn(), MofNCompleteColumn(), TextColumn(unit), rate, TimeRemainingColumn())
    begin = time.monotonic()
    with Progress(*columns, console=Console(stderr=True)) as shown:
        task = shown.add_task(unit, total=total, rate="")
        done = 0

        def advance(count: int) -> None:
            nonlocal done
            done += count
            per_second = done / max(time.monotonic() - begin, 1e-9)
            shown.update(task, advance=count, rate=f"{per_second:.3g}/s")

        yield advance


def _lines(unit: str, total: int) -> Callable[[int], None]:
    begin = said = time.monotonic()
    done = 0

    def advance(count: int) -> None:
        nonlocal done, said
        done += count
        now = time.monotonic()
        if now - said >= LINE_SECONDS or done == total:
            said = now
            rate = done / max(now - begin, 1e-9)
            left = (total - done) / max(rate, 1e-9)
            print(f"{done}/{total} {unit}, {rate:.3g}/s, {left:.0f} s left", file=sys.stderr)

    return advance
