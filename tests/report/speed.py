"""How soon a page answers, in Chromium on one core: python -m tests.report.speed PAGE.html [RUNS].

Interactive is when the last task of more than 50 ms ends that begins within 3 s; printed are the median and the slowest
of so many loads (5), and the sizes of the page and of its parts. The main thread's time is the processor's, which does
not hang on what else the machine does.
"""

import re
import statistics
import sys
import tempfile
import time
from pathlib import Path

from tests.report.browser import Browser

WATCH = """window.longTasks = [];
new PerformanceObserver((list) => { for (const e of list.getEntries()) longTasks.push([e.startTime, e.duration]); })
  .observe({ type: "longtask", buffered: true });"""


def main(page: Path, runs: int) -> None:
    text = page.read_text(encoding="utf-8")
    print(f"{page.name}: {len(text.encode()) / 1e6:.2f} MB")
    for name, pattern in (
        ("figures' library", r'id="plotly">(.*?)</script>'),
        ("live", r'class="program">(.*?)</script>'),
    ):
        found = re.search(pattern, text, re.S)
        print(f"  {name}: {len(found[1]) / 1e6 if found else 0:.2f} MB")
    ready, loaded = [], []
    for _ in range(runs):
        with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder, Browser(folder, core=0) as browser:
            browser.call("Page.addScriptToEvaluateOnNewDocument", source=WATCH)
            browser.call("Performance.enable", timeDomain="threadTicks")  # of the processor, whatever else it does
            browser.open(page)
            time.sleep(4)
            spent = {m["name"]: m["value"] for m in browser.call("Performance.getMetrics")["metrics"]}["TaskDuration"]
            tasks = [(a, d) for a, d in browser.run("longTasks") if a < 3000]
            load = browser.run("performance.getEntriesByType('navigation')[0].loadEventEnd")
            ready.append(max([load, *(a + d for a, d in tasks)]))
            loaded.append(load)
            long = [round(d) for _, d in tasks]
            said = f"loaded {load:.0f} ms, interactive {ready[-1]:.0f} ms, main thread {1000 * spent:.0f} ms"
            print(f"  {said}, long tasks {long}")
    print(f"interactive: median {statistics.median(ready):.0f} ms, slowest {max(ready):.0f} ms")


if __name__ == "__main__":
    main(Path(sys.argv[1]).resolve(), int(sys.argv[2]) if len(sys.argv) > 2 else 5)
