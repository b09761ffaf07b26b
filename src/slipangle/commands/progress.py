"""A progress bar on standard error that appears only when the work takes over a second, also amid a single step."""

from __future__ import annotations

import sys
import threading
import time
from types import TracebackType
from typing import Self

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn

PATIENCE = 1.0  # s before the bar appears


class Bar:
    """Callable as ``bar(share, what)``; quiet for machines."""

    def __init__(self, *, quiet: bool = False) -> None:
        self._quiet = quiet or not sys.stderr.isatty()
        self._began = time.monotonic()
        self._shown: Progress | None = None
        self._task = None
        self._last = (0.0, "")
        self._lock = threading.Lock()
        self._timer: threading.Timer | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def __call__(self, share: float, what: str) -> None:
        """Show that ``share`` (0 to 1) is done, and what is being done."""
        if self._quiet:
            return
        with self._lock:
            self._last = share, what
            if self._shown is not None and self._task is not None:
                self._shown.update(self._task, completed=share, description=what)
        if self._timer is None:
            left = PATIENCE - (time.monotonic() - self._began)
            self._timer = threading.Timer(max(left, 0.0), self._show)
            self._timer.daemon = True
            self._timer.start()

    def _show(self) -> None:
        """Begin to show what is being done now."""
        with self._lock:
            if self._quiet:
                return
            share, what = self._last
            columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeElapsedColumn())
            self._shown = Progress(*columns, console=Console(stderr=True), transient=True)
            self._shown.start()
            self._task = self._shown.add_task(what, total=1.0)
            self._shown.update(self._task, completed=share)

    def close(self) -> None:
        """Remove the bar."""
        if self._timer is not None:
            self._timer.cancel()
        with self._lock:
            self._quiet = True
            if self._shown is not None:
                self._shown.stop()
                self._shown, self._task = None, None
